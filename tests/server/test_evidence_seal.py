"""Sealing: signed with a key, timestamped by an authority on loopback, covered by the verifier."""

from __future__ import annotations

import datetime as dt
import hashlib
import http.server
import io
import json
import shutil
import subprocess
import threading
import zipfile

import httpx
import pytest
from crash_world import Reconstructor, crash
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from fleet_world import Leg, World, cut, drive_of
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from server.evidence.audit import audit
from server.evidence.seal import seal_waiting, signing_key, timestamp_holds, waiting
from server.evidence.verify import check, seal_message, signature_holds
from server.models import ChainSeal

OPENSSL = shutil.which("openssl")
needs_openssl = pytest.mark.skipif(OPENSSL is None, reason="no openssl to play the authority")
AUTHORITY = """
[tsa]
default_tsa = config
[config]
serial = {folder}/serial
signer_digest = sha256
default_policy = 1.2.3.4.1
digests = sha256
accuracy = secs:1
ordering = no
tsa_name = no
ess_cert_id_chain = no
ess_cert_id_alg = sha256
"""


def openssl(*words, **options):
    return subprocess.run([OPENSSL, *words], check=True, capture_output=True, **options)


@pytest.fixture
def authority(tmp_path):
    """Address and root certificate of a time-stamping authority on loopback."""
    folder = tmp_path / "tsa"
    folder.mkdir()
    (folder / "serial").write_text("01")
    (folder / "tsa.cnf").write_text(AUTHORITY.format(folder=folder))
    (folder / "ext.cnf").write_text("keyUsage=critical,digitalSignature\nextendedKeyUsage=critical,timeStamping\n")
    new_key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")
    openssl(
        "req", "-x509", *new_key, "-keyout", folder / "root.key", "-out", folder / "root.pem",
        "-subj", "/CN=Test root", "-days", "3650", "-addext", "basicConstraints=critical,CA:TRUE",
    )  # fmt: skip
    openssl("req", *new_key, "-keyout", folder / "tsa.key", "-out", folder / "tsa.csr", "-subj", "/CN=Test authority")
    openssl(
        "x509", "-req", "-in", folder / "tsa.csr", "-CA", folder / "root.pem", "-CAkey", folder / "root.key",
        "-set_serial", "2", "-days", "3650", "-extfile", folder / "ext.cnf", "-out", folder / "tsa.pem",
    )  # fmt: skip

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            (folder / "query").write_bytes(self.rfile.read(int(self.headers["Content-Length"])))
            openssl(
                "ts", "-reply", "-config", folder / "tsa.cnf", "-queryfile", folder / "query",
                "-signer", folder / "tsa.pem", "-inkey", folder / "tsa.key",
                "-out", folder / "reply",
            )  # fmt: skip
            self.send_response(200)
            self.send_header("Content-Type", "application/timestamp-reply")
            self.end_headers()
            self.wfile.write((folder / "reply").read_bytes())

        def log_message(self, *_):
            """Silent."""

    server = http.server.HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", folder / "root.pem"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "seal.pem"
    path.write_bytes(Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return path


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    world = World(database, settings, clock, organisation)
    world.reconstructor = Reconstructor(crash(100.0))
    for k, batch in enumerate(cut(drive_of(Leg(100, 12.0), Leg(60, 0.0)), seconds=40.0)):
        world.put(batch, k)
    world.bring_up()
    return world


def test_without_settings_nothing_is_sealed(world, settings):
    assert seal_waiting(world.database, settings, now=world.clock()) == 0
    assert not world.rows(ChainSeal)


@pytest.mark.both_databases
def test_a_chain_is_sealed_once_for_what_events_rest_on(world, settings, key_file):
    settings = settings.model_copy(update={"signing_key_file": key_file})
    assert seal_waiting(world.database, settings, now=world.clock()) == 1
    assert seal_waiting(world.database, settings, now=world.clock()) == 0
    row = world.one(ChainSeal)
    assert row.chain_length == 4
    assert row.public_key == signing_key(settings).public_key().public_bytes(Encoding.Raw, PublicFormat.Raw).hex()
    assert audit(world.database, world.store, world.device_id).passed
    with world.database.transaction() as session:
        session.get(ChainSeal, row.id).signature = "00" * 64
    assert audit(world.database, world.store, world.device_id).faults == ["the signature at 4 links does not hold"]
    world.put(cut(drive_of(Leg(20, 0.0)))[0], 9)
    world.bring_up()
    with world.database.reading() as session:
        assert waiting(session) == []  # what came since is not part of the event


@needs_openssl
def test_a_seal_is_timestamped_and_the_archive_shows_it(world, settings, key_file, authority, admin, app):
    url, root = authority
    settings = settings.model_copy(update={"signing_key_file": key_file, "timestamp_url": url})
    app.state.settings = settings
    assert seal_waiting(world.database, settings, now=world.clock()) == 1
    row = world.one(ChainSeal)
    message = seal_message(world.device_id, row.chain_length, row.chain_head)
    at = timestamp_holds(row.timestamp_token, message, root.read_bytes())
    assert at is not None
    assert abs(at - dt.datetime.now(dt.UTC)) < dt.timedelta(minutes=5)
    assert timestamp_holds(row.timestamp_token, message + b"x", root.read_bytes()) is None
    assert audit(world.database, world.store, world.device_id, root_pem=root.read_bytes()).passed
    (event,) = admin.get("/api/v1/events").json()["items"]
    content = admin.get(f"/api/v1/events/{event['id']}/evidence.zip").raise_for_status().content
    with zipfile.ZipFile(io.BytesIO(content)) as bundle:
        report = check(bundle.read, bundle.namelist())
        names = {line["check"] for line in report.lines}
        assert report.passed
        assert {
            "the signature holds",
            "the timestamp is of this seal",
            "the signature of the manifest holds",
            "the timestamp is of this manifest",
        } <= names
        chain = json.loads(bundle.read("chain.json"))
        (root.parent / "seal.txt").write_bytes(bundle.read("seal.txt"))
        (root.parent / "seal.tsr").write_bytes(bundle.read("seal.tsr"))
        (root.parent / "signature.txt").write_bytes(bundle.read("signature.txt"))
        (root.parent / "signature.tsr").write_bytes(bundle.read("signature.tsr"))
    assert chain["seal"]["public_key"] == row.public_key
    # As README.txt of the archive says.
    for name in ("seal", "signature"):
        said, token = root.parent / f"{name}.txt", root.parent / f"{name}.tsr"
        openssl("ts", "-verify", "-data", said, "-in", token, "-CAfile", root)


def test_an_authority_that_does_not_answer_stops_nothing(world, settings):
    settings = settings.model_copy(update={"timestamp_url": "http://127.0.0.1:9"})
    with pytest.raises(httpx.ConnectError):
        seal_waiting(world.database, settings, now=world.clock())
    assert not world.rows(ChainSeal)


@hypothesis_settings(max_examples=15, deadline=None)
@given(st.binary(max_size=200), st.binary(min_size=32, max_size=32), st.integers(0, 511))
def test_the_verifiers_own_ed25519_agrees_with_the_library(message, seed, bit):
    key = Ed25519PrivateKey.from_private_bytes(seed)
    public, signature = key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw), key.sign(message)
    assert signature_holds(public, message, signature)
    assert not signature_holds(public, message + b".", signature)
    broken = bytearray(signature)
    broken[bit // 8] ^= 1 << bit % 8
    assert not signature_holds(public, message, bytes(broken))


def test_a_key_file_of_another_kind_is_refused(settings, tmp_path):
    from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key

    path = tmp_path / "other.pem"
    path.write_bytes(generate_private_key(SECP256R1()).private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    with pytest.raises(ValueError, match="Ed25519"):
        signing_key(settings.model_copy(update={"signing_key_file": path}))


def test_a_hash_of_the_seal_is_what_the_documentation_says():
    assert (
        hashlib.sha256(seal_message("d", 3, "h")).hexdigest() == hashlib.sha256(b"scatola-seal-1\nd\n3\nh").hexdigest()
    )
