"""Check an archive of evidence: `python3 verify.py` in its folder, or `python3 verify.py ARCHIVE.zip`.

Needs Python 3.8 or newer and nothing else, no network and no other file of Scatola.  It answers four questions:

1. Are the files those that the archive lists?  (manifest.json: SHA-256 of each)
2. Are the raw data those that the box uploaded?  (columns and bodies against the hashes in chain.json)
3. Is the chain unbroken from before the event to its end in this archive?  (each link from the one before)
4. Was the chain's end sealed?  (Ed25519 signature; the digest in the RFC 3161 timestamp)

and checks that event.json is canonical, names these raw data, and has the hash that the report prints.
The signature tells who sealed it only if you know the public key from elsewhere; compare it.
"""

# It must run anywhere and stand alone, so it prints and repeats what the service says elsewhere.
# ruff: noqa: T201, UP006, UP035

import hashlib
import json
import sys
import zipfile
from pathlib import Path
from typing import Any, Callable, Dict, List, Set, Tuple

Point = Tuple[int, int, int, int]

# Ed25519 by RFC 8032, verification alone.
_P = 2**255 - 19
_L = 2**252 + 27742317777372353535851937790883648493
_D = -121665 * pow(121666, _P - 2, _P) % _P
_ROOT = pow(2, (_P - 1) // 4, _P)


def _x_of(y: int, odd: int) -> int:
    square = (y * y - 1) * pow(_D * y * y + 1, _P - 2, _P) % _P
    x = pow(square, (_P + 3) // 8, _P)
    if x * x % _P != square:
        x = x * _ROOT % _P
    if x * x % _P != square or (x == 0 and odd):
        raise ValueError("not a point of the curve")
    return _P - x if x % 2 != odd else x


def _point(data: bytes) -> Point:
    number = int.from_bytes(data, "little")
    y = number & (2**255 - 1)
    if y >= _P:
        raise ValueError("not a point of the curve")
    x = _x_of(y, number >> 255)
    return x, y, 1, x * y % _P


def _add(a: Point, b: Point) -> Point:
    m, n = (a[1] - a[0]) * (b[1] - b[0]) % _P, (a[1] + a[0]) * (b[1] + b[0]) % _P
    t, z = 2 * a[3] * b[3] * _D % _P, 2 * a[2] * b[2] % _P
    e, f, g, h = n - m, z - t, z + t, n + m
    return e * f % _P, g * h % _P, f * g % _P, e * h % _P


def _times(k: int, point: Point) -> Point:
    total = (0, 1, 1, 0)
    while k:
        if k & 1:
            total = _add(total, point)
        point = _add(point, point)
        k >>= 1
    return total


def signature_holds(public_key: bytes, message: bytes, signature: bytes) -> bool:
    """Whether an Ed25519 signature is that of the key's owner."""
    try:
        owner, commitment = _point(public_key), _point(signature[:32])
    except ValueError:
        return False
    s = int.from_bytes(signature[32:], "little")
    if len(signature) != 64 or s >= _L:
        return False
    y = 4 * pow(5, _P - 2, _P) % _P
    base_x = _x_of(y, 0)
    base = (base_x, y, 1, base_x * y % _P)
    h = int.from_bytes(hashlib.sha512(signature[:32] + public_key + message).digest(), "little") % _L
    left, right = _times(s, base), _add(commitment, _times(h, owner))
    same_x = (left[0] * right[2] - right[0] * left[2]) % _P == 0
    return same_x and (left[1] * right[2] - right[1] * left[2]) % _P == 0


def link(previous: str, row: Dict[str, Any]) -> str:
    """The link that follows `previous`; as the device protocol writes it."""
    parts = ("scatola-chain-1", previous, row["body_sha256"], row["column_sha256"], row["stream"], row["boot"])
    text = "\n".join((*parts, str(row["sequence"]), row["received_at"]))
    return hashlib.sha256(text.encode()).hexdigest()


def seal_message(device_id: str, length: int, head: str) -> bytes:
    """What a seal signs and has timestamped."""
    return "\n".join(("scatola-seal-1", device_id, str(length), head)).encode()


def canonical(document: Any) -> bytes:
    """The canonical form: numbers were rounded when it was written, so writing it again gives the same bytes."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


class Report:
    """What was checked, and how it went."""

    def __init__(self) -> None:
        self.lines: List[Dict[str, Any]] = []

    def add(self, what: str, good: bool, detail: str = "") -> None:
        self.lines.append({"check": what, "passed": bool(good), "detail": detail})

    @property
    def passed(self) -> bool:
        return all(line["passed"] for line in self.lines)


def check(read: Callable[[str], bytes], names: List[str]) -> Report:
    """All checks of an archive whose files `read` gives."""
    report = Report()
    try:
        manifest = json.loads(read("manifest.json"))
        chain = json.loads(read("chain.json"))
        _check_files(report, manifest, read, names)
        _check_chain(report, chain)
        _check_raw(report, chain, read, set(names))
        _check_event(report, manifest, chain, read)
        _check_seal(report, chain, read)
    except (KeyError, ValueError, TypeError) as error:
        report.add("the archive can be read", False, repr(error))
    return report


def _check_files(report: Report, manifest: Dict[str, Any], read: Callable[[str], bytes], names: List[str]) -> None:
    listed = manifest["files"]
    wrong = [n for n, told in listed.items() if n not in names or hashlib.sha256(read(n)).hexdigest() != told]
    extra = [n for n in names if n not in listed and n != "manifest.json"]
    report.add(
        "files are those of the manifest",
        not wrong and not extra,
        ", ".join([*wrong, *extra]) or f"{len(listed)} files",
    )


def _check_chain(report: Report, chain: Dict[str, Any]) -> None:
    head = chain["anchor"]
    for k, row in enumerate(chain["links"]):
        expected = link(head, row)
        if row["chain_sha256"] != expected or row["chain_index"] != chain["first_index"] + k:
            report.add("the chain is unbroken", False, f"link {row['chain_index']} does not follow from the one before")
            return
        head = expected
    whole = chain["first_index"] == 0
    if whole and chain["anchor"] != chain["device_id"]:
        report.add("the chain is unbroken", False, "it does not begin with the device's id")
        return
    where = "from the first upload" if whole else f"from link {chain['first_index']}"
    report.add("the chain is unbroken", head == chain["head"], f"{len(chain['links'])} links {where}")


def _check_raw(report: Report, chain: Dict[str, Any], read: Callable[[str], bytes], names: Set[str]) -> None:
    wrong: List[str] = []
    columns = bodies = 0
    for row in chain["links"]:
        for suffix, key in (("columns", "column_sha256"), ("body", "body_sha256")):
            name = f"raw/{row['chain_index']}.{suffix}"
            if name in names:
                wrong += [name] if hashlib.sha256(read(name)).hexdigest() != row[key] else []
                columns, bodies = columns + (suffix == "columns"), bodies + (suffix == "body")
    erased = [str(index) for index in chain["needed"] if f"raw/{index}.columns" not in names]
    told = f"{columns} uploads, of {bodies} also the body as it came" + (
        f"; erased: {', '.join(erased)}" if erased else ""
    )
    report.add("raw data are those in the chain", not wrong, ", ".join(wrong) or told)


def _check_event(report: Report, manifest: Dict[str, Any], chain: Dict[str, Any], read: Callable[[str], bytes]) -> None:
    content = read("event.json")
    document = json.loads(content)
    hashed = hashlib.sha256(content).hexdigest()
    report.add("event.json is canonical", canonical(document) == content, hashed)
    report.add("its hash is the one that the report prints", hashed == manifest["event_sha256"], hashed)
    links = {row["chain_index"]: row for row in chain["links"]}
    batches = document["inputs"]["batches"]
    same = all(
        batch["chain_index"] in links
        and all(links[batch["chain_index"]][key] == batch[key] for key in ("body_sha256", "column_sha256"))
        for batch in batches
    )
    report.add("the event was computed from these uploads", same, f"{len(batches)} uploads")
    inputs = {name: value for name, value in document["inputs"].items() if name != "sha256"}
    hashed = hashlib.sha256(canonical(inputs)).hexdigest()
    report.add("the hash of its inputs holds", hashed == document["inputs"]["sha256"], hashed)


def _check_seal(report: Report, chain: Dict[str, Any], read: Callable[[str], bytes]) -> None:
    seal = chain["seal"]
    if seal is None:
        report.add(
            "sealed", True, "no: the operator set neither key nor time-stamping authority, or the seal is to come"
        )
        return
    covered = [row["chain_sha256"] for row in chain["links"] if row["chain_index"] + 1 == seal["chain_length"]]
    report.add("the seal is one of this chain", covered == [seal["chain_head"]], f"link {seal['chain_length'] - 1}")
    message = seal_message(chain["device_id"], seal["chain_length"], seal["chain_head"])
    if seal["signature"] is not None:
        key, signature = bytes.fromhex(seal["public_key"]), bytes.fromhex(seal["signature"])
        report.add("the signature holds", signature_holds(key, message, signature), f"Ed25519 key {seal['public_key']}")
    if seal["timestamped"]:
        # Its own signature is the authority's: openssl ts -verify -data seal.txt -in seal.tsr -CAfile ROOT.pem
        inside = hashlib.sha256(message).digest() in read("seal.tsr")
        report.add(
            "the timestamp is of this seal", inside and read("seal.txt") == message, "see README.txt for openssl"
        )


def main(arguments: List[str]) -> int:
    """Check a folder or an archive and say so."""
    place = Path(arguments[1]) if len(arguments) > 1 else Path(__file__).resolve().parent
    if place.is_dir():
        names = sorted(
            p.relative_to(place).as_posix() for p in place.rglob("*") if p.is_file() and "__pycache__" not in p.parts
        )
        report = check(lambda name: (place / name).read_bytes(), names)
    else:
        with zipfile.ZipFile(place) as archive:
            report = check(archive.read, archive.namelist())
    for line in report.lines:
        print(
            ("  ok    " if line["passed"] else "  WRONG ")
            + line["check"]
            + (f": {line['detail']}" if line["detail"] else "")
        )
    print("Everything holds." if report.passed else "SOMETHING DOES NOT HOLD.")
    return 0 if report.passed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv))
