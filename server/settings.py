"""Settings, read once from the environment; see docs/operations.md for each."""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated, Literal

import platformdirs
from pydantic import Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

SECRETS = ("database_url", "broker_url", "blob_url", "admin_token")


def _default_data_dir() -> Path:
    return Path(platformdirs.user_data_dir("scatola", appauthor=False))


class Settings(BaseSettings):
    """Everything an operator can choose; each is an environment variable with the prefix SCATOLA_."""

    # A folder of secrets as containers mount them: a file for each variable, in lower case.
    model_config = SettingsConfigDict(
        env_prefix="SCATOLA_", extra="ignore", frozen=True, secrets_dir=os.environ.get("SCATOLA_SECRETS_DIR")
    )

    data_dir: Path = Field(default_factory=_default_data_dir)
    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    database_url: SecretStr | None = None
    broker_url: SecretStr | None = None
    blob_url: SecretStr | None = None
    viewer_url: str | None = None
    trusted_origins: Annotated[tuple[str, ...], NoDecode] = ()
    map_tiles_url: str | None = None
    map_pmtiles: str | None = None
    admin_token: SecretStr | None = None
    signing_key_file: Path | None = None
    timestamp_url: str | None = None
    timestamp_root_file: Path | None = None
    smtp_host: str | None = None
    smtp_port: int = Field(default=587, ge=1, le=65535)
    smtp_security: Literal["starttls", "tls", "none"] = "starttls"
    smtp_user: str | None = None
    smtp_password: SecretStr | None = None
    smtp_sender: str = "scatola@localhost"
    public_url: str | None = None
    webhook_networks: Annotated[tuple[str, ...], NoDecode] = ()
    alert_ca_file: Path | None = None
    alert_attempts: int = Field(default=10, ge=1, le=50)
    max_body_bytes: int = Field(default=16 * 1024 * 1024, gt=0)
    max_decoded_bytes: int = Field(default=64 * 1024 * 1024, gt=0)
    device_requests_per_minute: int = Field(default=600, gt=0)
    device_bytes_per_day: int = Field(default=2 * 1024**3, gt=0)
    drain_seconds: float | None = Field(default=None, ge=0, le=6)
    metrics_port: int | None = Field(default=None, ge=0, le=65535)
    metrics_host: str = "127.0.0.1"
    otlp_endpoint: str | None = None
    log_json: bool = False
    log_level: Literal["debug", "info", "warning", "error"] = "info"

    @model_validator(mode="before")
    @classmethod
    def _read_files(cls, given: dict[str, object]) -> dict[str, object]:
        """A secret may stand in a file of its own, which SCATOLA_<NAME>_FILE names; the variable itself wins."""
        for name in SECRETS:
            path = os.environ.get(f"SCATOLA_{name.upper()}_FILE")
            if path and name not in given:
                try:
                    given[name] = Path(path).read_text(encoding="utf-8").strip()
                except (OSError, UnicodeError) as error:
                    raise ValueError(f"SCATOLA_{name.upper()}_FILE: {path} cannot be read: {error}") from error
        return given

    @field_validator("trusted_origins", "webhook_networks", mode="before")
    @classmethod
    def _split(cls, value: object) -> object:
        if isinstance(value, str):
            return tuple(part.strip() for part in value.split(",") if part.strip())
        return value

    @field_validator("webhook_networks")
    @classmethod
    def _are_networks(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for network in value:
            ip_network(network)  # its ValueError names what is wrong
        return value

    @property
    def embedded(self) -> bool:
        """Whether this installation runs everything itself on SQLite and a folder."""
        return self.broker_url is None

    @property
    def drain_s(self) -> float:
        """How long the API answers 503 on /readyz before it takes no more connections.

        A balancer in front of several needs the time to notice; an installation on its own has none.
        """
        return self.drain_seconds if self.drain_seconds is not None else 0.0 if self.embedded else 3.0

    @property
    def database_dsn(self) -> str:
        """SQLAlchemy URL of the database; a bare postgresql:// is given the psycopg 3 driver."""
        if self.database_url is None:
            return f"sqlite:///{self.data_dir / 'scatola.sqlite3'}"
        url = self.database_url.get_secret_value()
        for scheme in ("postgresql://", "postgres://"):
            if url.startswith(scheme):
                return "postgresql+psycopg://" + url.removeprefix(scheme)
        return url


def share_figures() -> None:
    """Let the processes that this one starts count into the figures that it shows.

    Before prometheus_client is imported.  The folder is of this run alone: an earlier run's counts are not shown.
    """
    if not os.environ.get("PROMETHEUS_MULTIPROC_DIR"):
        folder = tempfile.mkdtemp(prefix="scatola-figures-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        os.environ["PROMETHEUS_MULTIPROC_DIR"] = folder


def set_numba_cache_dir() -> None:
    """Choose where compiled kernels live, before numba is imported: the installation, else the user's cache."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return
    for folder in (Path(sys.prefix) / "var" / "numba", Path(platformdirs.user_cache_dir("scatola")) / "numba"):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            os.environ["NUMBA_CACHE_DIR"] = str(folder)
            return
