"""The production shape: valid by the format's schema, closed where it can be; its commands run outside containers."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import urllib.request
from importlib import resources
from pathlib import Path

import httpx
import pytest
import yaml

from tests.conftest import missing_service
from tests.e2e.service import eventually, free_port

ROOT = Path(__file__).resolve().parents[2]
ONE_SHOT = {"prepare", "migrate", "bucket"}
CAPABILITIES = {
    "prepare": ["CHOWN"],
    # The image's binary carries it as a file capability: the kernel starts it only where the bounding set has it, too.
    "proxy": ["NET_BIND_SERVICE"],
}
AMQP = "amqp://guest:guest@127.0.0.1:5672/"


@pytest.fixture(scope="module")
def compose() -> dict:
    return yaml.safe_load((ROOT / "docker-compose.yml").read_text())


def test_it_is_valid(compose):
    """By the schema of the compose specification that the checker carries."""
    vendored = resources.files("check_jsonschema") / "builtin_schemas" / "vendor" / "compose-spec.json"
    run = subprocess.run(
        [sys.executable, "-m", "check_jsonschema", "--schemafile", str(vendored), str(ROOT / "docker-compose.yml")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    for service in compose["services"].values():
        for other, needs in service.get("depends_on", {}).items():
            healthy = needs["condition"] == "service_healthy"
            assert ("healthcheck" in compose["services"][other]) == healthy, other
            assert (other in ONE_SHOT) != healthy, other
        for secret in service.get("secrets", []):
            assert compose["secrets"][secret] == {"file": f"secrets/{secret}"}
        for volume in service.get("volumes", []):
            assert volume.startswith("./") or volume.split(":")[0] in compose["volumes"]


def test_every_service_is_closed(compose):
    for name, service in compose["services"].items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        if name != "prepare":
            assert service["user"] not in ("root", "0", "0:0"), name
        assert service.get("cap_add", []) == CAPABILITIES.get(name, []), name
        assert "privileged" not in service, name
        assert service["restart"] == ("no" if name in ONE_SHOT else "unless-stopped"), name
        assert ("healthcheck" in service) == (name not in ONE_SHOT), name
        assert ":" in service.get("image", "") or service["image"] == "scatola", name
        assert "latest" not in service["image"], name
        for variable, value in service.get("environment", {}).items():
            if re.search("PASSWORD|TOKEN|SECRET|DATABASE_URL|BROKER_URL", variable):
                assert variable.endswith("_FILE"), (name, variable)
                assert value.startswith("/run/secrets/"), (name, variable)
                assert value.removeprefix("/run/secrets/") in service["secrets"], (name, variable)
    published = [name for name, service in compose["services"].items() if "ports" in service]
    assert published == ["proxy"]


def test_secrets_are_readable_for_every_image_and_for_nobody_else(compose):
    """Compose mounts a secret as it lies on the host, and the images run as several users: one group for all."""
    for name, service in compose["services"].items():
        assert service["group_add"] == ["10001"], name
    told = (ROOT / "docs" / "operations.md").read_text()
    made = told[told.index("mkdir -p secrets") : told.index("docker compose up -d\n```")]
    assert "umask 077" in made
    assert re.search(r"chgrp 10001 \* && chmod 640 \*", made)
    assert all(name in made for name in compose["secrets"])


def test_every_other_setting_reaches_the_containers(compose):
    """From a file that need not be there; what the compose file itself says is not asked of the shell besides."""
    for name in ("migrate", "api", "worker", "viewer"):
        service = compose["services"][name]
        assert service["env_file"] == [{"path": "scatola.env", "required": False}], name
        assert not [value for value in service["environment"].values() if "${" in str(value)], name


def test_what_must_keep_its_name_or_a_home_on_a_closed_file_system(compose):
    services = compose["services"]
    assert services["broker"]["hostname"] == "broker"
    assert services["objects"]["environment"]["HOME"] == "/tmp"
    assert services["bucket"]["environment"]["MC_CONFIG_DIR"].startswith("/tmp/")


def test_the_image_has_the_python_that_is_tested():
    lock = (ROOT / "Makefile").read_text()
    version = re.search(r"--python-version (\S+)", lock)[1]
    assert set(re.findall(r"^FROM python:(\S+)-slim", (ROOT / "Dockerfile").read_text(), re.MULTILINE)) == {version}


def test_the_image_runs_as_the_user_that_compose_names(compose):
    dockerfile = (ROOT / "Dockerfile").read_text()
    assert "--uid 10001" in dockerfile
    assert re.search(r"^USER scatola$", dockerfile, re.MULTILINE)
    assert compose["services"]["api"]["user"].startswith("10001")


class Role:
    """A service's command as the compose file writes it, in a process of its own."""

    def __init__(self, compose: dict, name: str, environment: dict[str, str], ports: dict[str, str], log: Path) -> None:
        self.service = compose["services"][name]
        written = {variable: str(value) for variable, value in self.service["environment"].items()}
        clean = {variable: value for variable, value in os.environ.items() if not variable.startswith("SCATOLA_")}
        self._ports = ports
        # The environment as written, then what is elsewhere outside containers: addresses, folders, ports.
        self._environment = clean | {k: v for k, v in written.items() if "${" not in v} | environment
        self._command = [self._moved(word) for word in self.service["command"]]
        self._log = log

    def _moved(self, word: str) -> str:
        for written, free in self._ports.items():
            word = re.sub(rf"\b{written}\b", free, word)
        return word

    def start(self) -> subprocess.Popen:
        command = [sys.executable, "-m", "server.cli.main", *self._command]
        with self._log.open("ab") as log:
            return subprocess.Popen(command, env=self._environment, stdout=log, stderr=log)

    def healthy(self) -> bool:
        kind, _, *arguments = map(self._moved, self.service["healthcheck"]["test"])
        assert kind == "CMD"
        return subprocess.run([sys.executable, *arguments], capture_output=True, check=False).returncode == 0


@pytest.mark.postgres
@pytest.mark.rabbitmq
def test_the_commands_run_as_written_outside_containers(compose, request, tmp_path):
    pika = pytest.importorskip("pika")
    try:
        pika.BlockingConnection(pika.URLParameters(AMQP)).close()
    except pika.exceptions.AMQPError as error:
        missing_service(f"no RabbitMQ at 127.0.0.1:5672: {type(error).__name__}")
    secrets = tmp_path / "secrets"
    secrets.mkdir(mode=0o700)
    (tmp_path / "objects").mkdir()
    for name, value in (
        ("scatola_database_url", request.getfixturevalue("postgres_url")),
        ("scatola_broker_url", AMQP),
        ("scatola_admin_token", "administrator-of-compose\n"),
    ):
        (secrets / name).write_text(value)
    ports = {each: str(free_port()) for each in ("8000", "8001", "9100")}
    environment = {
        **{
            f"{name.upper()}_FILE": str(secrets / name)
            for name in sorted(compose["secrets"])
            if (secrets / name).exists()
        },
        "SCATOLA_DATA_DIR": str(tmp_path / "data"),
        "SCATOLA_PORT": ports["8000"],
        "SCATOLA_METRICS_PORT": ports["9100"],
        "SCATOLA_BLOB_URL": (tmp_path / "objects").as_uri(),
        "SCATOLA_VIEWER_URL": f"http://127.0.0.1:{ports['8001']}",
        "SCATOLA_OTLP_ENDPOINT": "",
    }
    log = tmp_path / "log"
    roles = {name: Role(compose, name, environment, ports, log) for name in ("migrate", "api", "worker", "viewer")}
    assert roles["migrate"].start().wait(120) == 0, log.read_text()
    running = {name: roles[name].start() for name in ("api", "worker", "viewer")}
    try:
        for name in running:
            eventually(roles[name].healthy, within_s=120, what=f"{name} is healthy: {log.read_text()[-2000:]}")
        url = f"http://127.0.0.1:{ports['8000']}"
        admin = {"Authorization": "Bearer administrator-of-compose"}
        with httpx.Client(base_url=url, timeout=20) as client:
            assert client.get("/readyz", params={"every": True}).json()["checks"]["broker"] is True
            token = client.post("/api/v1/devices", json={"name": "box"}, headers=admin).json()["token"]
            columns = {"t": [0.0, 0.5], "fx": [0, 0], "fy": [0, 0], "fz": [-9.8, -9.8]}
            headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": "b/0"}
            assert client.post("/api/v1/batches", json={"columns": columns}, headers=headers).status_code == 202
            eventually(
                lambda: "scatola_due_batches 0.0" in client.get("/metrics").text,
                within_s=120,
                what="a worker works off what came",
            )
            assert "scatola_queue_messages" in client.get("/metrics").text
        with urllib.request.urlopen(f"http://127.0.0.1:{ports['9100']}/metrics") as answer:
            assert b'scatola_jobs_total{outcome="done"' in answer.read()
    finally:
        for process in running.values():
            process.terminate()
        for process in running.values():
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()
    # uvicorn raises the signal again once it has ended in order.
    assert all(process.returncode in (0, -signal.SIGTERM) for process in running.values()), log.read_text()
    assert "administrator-of-compose" not in log.read_text()


def test_a_secret_in_a_file_of_its_own(tmp_path, monkeypatch):
    from server.settings import Settings

    path = tmp_path / "token"
    path.write_text("from the file\n")
    monkeypatch.setenv("SCATOLA_ADMIN_TOKEN_FILE", str(path))
    monkeypatch.delenv("SCATOLA_ADMIN_TOKEN", raising=False)
    assert Settings().admin_token.get_secret_value() == "from the file"
    monkeypatch.setenv("SCATOLA_ADMIN_TOKEN", "from the environment")
    assert Settings().admin_token.get_secret_value() == "from the environment"
    monkeypatch.delenv("SCATOLA_ADMIN_TOKEN")
    path.unlink()
    with pytest.raises(ValueError, match="SCATOLA_ADMIN_TOKEN_FILE"):
        Settings()
