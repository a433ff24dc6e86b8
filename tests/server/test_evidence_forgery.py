"""Archives of evidence that were forged by somebody who computes every hash again, and honest ones that look odd."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile

import pytest
from crash_world import Reconstructor, crash
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from fleet_world import Leg, World, cut, drive_of

from server.evidence.seal import public_key, seal_waiting, signing_key
from server.evidence.verify import canonical, check, columns_of, main, manifest_message, seal_message
from server.models import Batch, ChainSeal

SIGNATURE = ("signature.json", "signature.txt")


@pytest.fixture
def signing(tmp_path, settings, app):
    """Settings of an operator who signs; the service has them too."""
    path = tmp_path / "seal.pem"
    path.write_bytes(Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    app.state.settings = settings.model_copy(update={"signing_key_file": path})
    return app.state.settings


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    world = World(database, settings, clock, organisation)
    world.reconstructor = Reconstructor(crash(100.0))
    for k, batch in enumerate(cut(drive_of(Leg(100, 12.0), Leg(60, 0.0)), seconds=40.0)):
        world.put(batch, k)
    world.bring_up()
    return world


def archive_of(admin) -> dict[str, bytes]:
    (event,) = admin.get("/api/v1/events").json()["items"]
    content = admin.get(f"/api/v1/events/{event['id']}/evidence.zip").raise_for_status().content
    with zipfile.ZipFile(io.BytesIO(content)) as bundle:
        return {name: bundle.read(name) for name in bundle.namelist()}


def verdict(files, key=None):
    return check(files.__getitem__, list(files), key)


def faults(files, key=None) -> list[str]:
    return [line["check"] for line in verdict(files, key).lines if not line["passed"]]


def with_new_manifest(files: dict[str, bytes]) -> dict[str, bytes]:
    manifest = json.loads(files["manifest.json"])
    manifest["event_sha256"] = hashlib.sha256(files["event.json"]).hexdigest()
    outside = ("manifest.json", *SIGNATURE)
    manifest["files"] = {n: hashlib.sha256(d).hexdigest() for n, d in files.items() if n not in outside}
    return {**files, "manifest.json": json.dumps(manifest, indent=1).encode()}


def signed_by(key, files: dict[str, bytes]) -> dict[str, bytes]:
    message = manifest_message(files["manifest.json"])
    told = {"public_key": public_key(key), "signature": key.sign(message).hex(), "timestamped": False}
    return {**files, "signature.json": json.dumps(told).encode(), "signature.txt": message}


def another_event(files):
    document = json.loads(files["event.json"])
    document["event"]["delta_v_kmh"]["resultant"] = 5.0
    content = canonical(document)
    edr = {**json.loads(files["edr.json"]), "event_sha256": hashlib.sha256(content).hexdigest()}
    return {**files, "event.json": content, "edr.json": json.dumps(edr).encode()}


def no_seal(files):
    chain = {**json.loads(files["chain.json"]), "seal": None}
    return {**{n: d for n, d in files.items() if n != "seal.txt"}, "chain.json": json.dumps(chain).encode()}


FORGERIES = {
    "event": another_event,
    "csv": lambda files: {**files, "raw/1.csv": b"t,fx\n0,0\n"},
    "reports": lambda files: {**files, "report-en.pdf": b"no pdf", "edr.json": b"{}"},
    "edr.csv": lambda files: {**files, "edr.csv": files["edr.csv"].replace(b"km/h", b"mph", 1)},
    "raw": lambda files: {n: d for n, d in files.items() if not n.startswith("raw/")},
    "seal": no_seal,
    "revision": lambda files: {**files, "revisions/1.json": b"{}"},
    "seal.txt": lambda files: {**files, "seal.txt": b"x"},
}
# Those that the contents of an archive show by themselves, without any signature.
CONTRADICTIONS = {
    "csv": ["raw/N.csv tell what raw/N.columns hold"],
    "reports": ["edr.json tells what event.json tells"],
    "edr.csv": ["edr.csv tells what event.json tells"],
    "raw": ["raw data are there of all that the event rests on"],
    "seal.txt": ["seal.txt is what was sealed"],
}


def test_every_forgery_of_a_signed_archive_is_found(world, signing, admin):
    assert seal_waiting(world.database, signing, now=world.clock()) == 1
    base, key = archive_of(admin), public_key(signing_key(signing))
    assert faults(base) == faults(base, key) == []
    (limit,) = verdict(base).limits
    assert limit.startswith("whose key signed it")
    assert verdict(base, key).limits == []
    for name, forge in FORGERIES.items():
        forged = with_new_manifest(forge(base))
        assert forged != base
        own = CONTRADICTIONS.get(name, [])
        broken = ["the signature of the manifest holds", "signature.txt is what was signed"]
        assert faults(forged) == [*broken, *own], name
        bare = {n: d for n, d in forged.items() if n not in SIGNATURE}
        # The seal alone tells that a signature was taken away; without the seal too, only the key does.
        assert faults(bare) == [*([] if name == "seal" else ["the manifest is signed"]), *own], name
        assert "signed by the key that you gave" in faults(bare, key), name
        assert any(limit.startswith("NOT SIGNED") for limit in verdict(bare).limits), name
        other = signed_by(Ed25519PrivateKey.generate(), forged)
        assert faults(other) == own, name
        assert faults(other, key) == ["signed by the key that you gave", *own], name


def test_an_archive_without_a_key_says_what_it_does_not_prove(world, admin):
    del world
    base = archive_of(admin)
    report = verdict(base)
    assert report.passed
    assert [limit.split(":")[0] for limit in report.limits] == ["NOT SIGNED", "NOT SEALED"]
    for name, found in CONTRADICTIONS.items():
        told = faults(with_new_manifest(FORGERIES[name](base)))
        assert told == (["sealed"] if name == "seal.txt" else found)


def test_a_seal_older_than_the_archive_is_no_fault(world, signing, admin):
    assert seal_waiting(world.database, signing, now=world.clock()) == 1
    batches, row = world.rows(Batch, Batch.chain_index), world.one(ChainSeal)
    first = json.loads(archive_of(admin)["chain.json"])["first_index"]
    assert first >= 1

    def sealed_at(length: int, head: str) -> dict[str, bytes]:
        with world.database.transaction() as session:
            seal = session.get(ChainSeal, row.id)
            seal.chain_length, seal.chain_head = length, head
            seal.signature = signing_key(signing).sign(seal_message(world.device_id, length, head)).hex()
        return archive_of(admin)

    at_anchor = sealed_at(first, batches[first - 1].chain_sha256)
    assert faults(at_anchor) == []
    assert any("NOT SEALED YET" in limit for limit in verdict(at_anchor).limits)
    assert faults(sealed_at(first, "0" * 64)) == ["the seal is one of this chain"]
    earlier = verdict(sealed_at(first - 1, "0" * 64))
    assert earlier.passed
    (told,) = [line["detail"] for line in earlier.lines if line["check"] == "the seal is one of this chain"]
    assert "before this archive begins; not covered" in told


def test_an_archive_is_refused_where_its_key_cannot_be_read(world, signing, admin):
    del world
    signing.signing_key_file.unlink()
    (event,) = admin.get("/api/v1/events").json()["items"]
    assert admin.get(f"/api/v1/events/{event['id']}/evidence.zip").status_code == 503


def test_columns_read_as_the_store_holds_them(world, admin):
    del world
    files = archive_of(admin)
    columns = columns_of(files["raw/1.columns"])
    assert "t" in columns
    assert len({len(values) for values in columns.values()}) == 1
    with pytest.raises(ValueError, match="not columns"):
        columns_of(b"other\n")


@pytest.mark.parametrize("missing", ["event.json", "manifest.json", "chain.json", "edr.json", "edr.csv", "seal.txt"])
def test_a_folder_that_lacks_a_file_is_told_so(world, signing, admin, tmp_path, capsys, missing):
    assert seal_waiting(world.database, signing, now=world.clock()) == 1
    folder = tmp_path / "unpacked"
    for name, data in archive_of(admin).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    assert main(["verify.py", str(folder), "--key", public_key(signing_key(signing))]) == 0
    (folder / missing).unlink()
    assert main(["verify.py", str(folder)]) == 1
    assert missing in capsys.readouterr().out
    assert main(["verify.py", str(folder / "none.zip")]) == 1
