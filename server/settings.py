"""Settings, read once from the environment; see docs/operations.md for each."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import platformdirs
from pydantic import Field, SecretStr, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict


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
    max_body_bytes: int = Field(default=16 * 1024 * 1024, gt=0)
    max_decoded_bytes: int = Field(default=64 * 1024 * 1024, gt=0)
    device_requests_per_minute: int = Field(default=600, gt=0)
    device_bytes_per_day: int = Field(default=2 * 1024**3, gt=0)
    log_json: bool = False
    log_level: Literal["debug", "info", "warning", "error"] = "info"

    @field_validator("trusted_origins", mode="before")
    @classmethod
    def _split(cls, value: object) -> object:
        if isinstance(value, str):
            return tuple(part.strip() for part in value.split(",") if part.strip())
        return value

    @property
    def embedded(self) -> bool:
        """Whether this installation runs everything itself on SQLite and a folder."""
        return self.broker_url is None

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
