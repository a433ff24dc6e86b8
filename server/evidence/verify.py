"""Check an archive of evidence: `python3 verify.py [ARCHIVE.zip or its folder] [--key PUBLIC-KEY]`.

Needs Python 3.8 or newer and nothing else, no network and no other file of Scatola.  It answers five questions:

1. Are the files those that the archive lists?  (manifest.json: SHA-256 of each)
2. Did the operator sign that list?  (signature.json: Ed25519; signature.tsr: RFC 3161 timestamp)
3. Are the raw data those that the box uploaded?  (columns and bodies against the hashes in chain.json)
4. Is the chain unbroken from before the event to its end in this archive?  (each link from the one before)
5. Was the chain's end sealed?  (Ed25519 signature; the digest in the RFC 3161 timestamp)

and checks that event.json is canonical and names these raw data, and that the tables tell what it tells.

Hashes alone show damage, not forgery: whoever alters a file can compute them again.  Only a signature stands against
that, and only by a key that you know from elsewhere: give its public half with --key, and anything not signed by it
fails.  Take this program from elsewhere too where you do not trust the archive.
"""

# It must run anywhere and stand alone, so it prints and repeats what the service says elsewhere.
# ruff: noqa: B905, T201, UP006, UP035, UP045

import csv
import hashlib
import io
import json
import math
import struct
import sys
import zipfile
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional, Set, Tuple

# What cannot stand in the manifest, which is what they are about.
OUTSIDE = ("manifest.json", "signature.json", "signature.txt", "signature.tsr")

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


def manifest_message(manifest: bytes) -> bytes:
    """What the signature of an archive signs and has timestamped."""
    return ("scatola-manifest-1\n" + hashlib.sha256(manifest).hexdigest()).encode()


def canonical(document: Any) -> bytes:
    """The canonical form: numbers were rounded when it was written, so writing it again gives the same bytes."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


class Report:
    """What was checked, and how it went."""

    def __init__(self) -> None:
        self.lines: List[Dict[str, Any]] = []
        self.limits: List[str] = []
        """What nothing here stands against."""

    def add(self, what: str, good: bool, detail: str = "") -> None:
        self.lines.append({"check": what, "passed": bool(good), "detail": detail})

    @property
    def passed(self) -> bool:
        return all(line["passed"] for line in self.lines)


def check(read: Callable[[str], bytes], names: List[str], key: Optional[str] = None) -> Report:
    """All checks of an archive whose files `read` gives; with a public key (hex), only what it signed holds."""
    report = Report()
    try:
        manifest = json.loads(read("manifest.json"))
        _check_files(report, manifest, read, names)
        chain = json.loads(read("chain.json"))
        _check_names(report, manifest, chain)
        _check_signature(report, chain, read, names, key)
        _check_chain(report, chain)
        _check_event(report, manifest, chain, read)
        _check_raw(report, chain, json.loads(read("event.json")), read, set(names))
        _check_tables(report, chain, read, set(names))
        _check_seal(report, chain, read, set(names))
    except Exception as error:  # noqa: BLE001  whatever damage makes a reader of zip or JSON raise
        report.add("the archive can be read", False, f"{type(error).__name__}: {error}")
    return report


def _check_files(report: Report, manifest: Dict[str, Any], read: Callable[[str], bytes], names: List[str]) -> None:
    listed = manifest["files"]
    wrong = [n for n, told in listed.items() if n not in names or hashlib.sha256(read(n)).hexdigest() != told]
    wrong += [n for n in names if (n not in listed and n not in OUTSIDE) or names.count(n) > 1]
    report.add("files are those of the manifest", not wrong, ", ".join(wrong) or f"{len(listed)} files")


def _check_names(report: Report, manifest: Dict[str, Any], chain: Dict[str, Any]) -> None:
    """Whether the manifest is of a kind that this program knows, and names the event that its files are of."""
    wrong = [] if manifest["schema"] == "scatola-evidence-1" else ["schema"]
    # Archives made before chain.json named the event have nothing to compare with.
    wrong += [name for name in ("event_id", "revision") if chain.get(name, manifest[name]) != manifest[name]]
    report.add("the manifest names this event", not wrong, ", ".join(wrong) or manifest["event_id"])


def _check_signature(
    report: Report, chain: Dict[str, Any], read: Callable[[str], bytes], names: List[str], key: Optional[str]
) -> None:
    """Whether somebody answers for the manifest, and so for every file."""
    told = json.loads(read("signature.json")) if "signature.json" in names else {}
    message = manifest_message(read("manifest.json"))
    signed, stamped = told.get("signature") is not None, bool(told.get("timestamped"))
    if signed:
        good = signature_holds(bytes.fromhex(told["public_key"]), message, bytes.fromhex(told["signature"]))
        report.add("the signature of the manifest holds", good, f"every file, Ed25519 key {told['public_key']}")
    if stamped or "signature.tsr" in names:
        inside = hashlib.sha256(message).digest() in read("signature.tsr")
        report.add("the timestamp is of this manifest", inside, "see README.txt for openssl")
    if signed or stamped or "signature.txt" in names:
        report.add("signature.txt is what was signed", read("signature.txt") == message)
    if key is not None:
        report.add("signed by the key that you gave", signed and told["public_key"].lower() == key.lower(), key)
    elif signed:
        report.limits.append("whose key signed it: compare it with the operator's, or give that with --key")
    if not signed:
        # An operator who signs seals signs archives; one without is one whose signature was taken away.
        sealed = chain["seal"] is not None and chain["seal"]["signature"] is not None
        report.add("the manifest is signed", not sealed, "no" + (", though the seal is" if sealed else ""))
        report.limits.append(
            "NOT SIGNED: event.json, reports, tables and revisions are tied to each other by hashes alone, which "
            "whoever alters them can compute again; compare the SHA-256 of event.json with one known from elsewhere"
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


def _check_raw(
    report: Report, chain: Dict[str, Any], document: Dict[str, Any], read: Callable[[str], bytes], names: Set[str]
) -> None:
    wrong: List[str] = []
    columns = bodies = 0
    for row in chain["links"]:
        for suffix, key in (("columns", "column_sha256"), ("body", "body_sha256")):
            name = f"raw/{row['chain_index']}.{suffix}"
            if name in names:
                wrong += [name] if hashlib.sha256(read(name)).hexdigest() != row[key] else []
                columns, bodies = columns + (suffix == "columns"), bodies + (suffix == "body")
    told = f"{columns} uploads, of {bodies} also the body as it came"
    report.add("raw data are those in the chain", not wrong, ", ".join(wrong) or told)
    needed = {*chain["needed"], *(batch["chain_index"] for batch in document["inputs"]["batches"])}
    gone = [f"raw/{index}.columns" for index in sorted(needed) if f"raw/{index}.columns" not in names]
    told_erased = {f"raw/{row['chain_index']}.columns" for row in chain["links"] if row.get("erased_at")}
    erased = [name for name in gone if name in told_erased]
    if erased:
        report.limits.append(
            "ERASED: " + ", ".join(erased) + ": the operator says that the raw data were erased by retention or "
            "order; their hashes stay in the chain, and the event cannot be computed again from this archive"
        )
    gone = [name for name in gone if name not in told_erased]
    report.add(
        "raw data are there of all that the event rests on", not gone, ", ".join(gone) or f"{len(needed)} uploads"
    )


def columns_of(content: bytes) -> Dict[str, Tuple[float, ...]]:
    """What a .columns file holds, NaN where not sampled."""
    start = content.index(b"\n") + 1
    if content[:start] != b"scatola-columns-1\n":
        raise ValueError("not columns of this kind")
    found: Dict[str, Tuple[float, ...]] = {}
    while start < len(content):
        end = content.index(b"\n", start)
        name, _, rows = content[start:end].decode().rsplit(" ", 2)
        found[name] = struct.unpack_from(f"<{int(rows)}d", content, end + 1)
        start = end + 1 + 8 * int(rows)
    return found


def _check_tables(report: Report, chain: Dict[str, Any], read: Callable[[str], bytes], names: Set[str]) -> None:
    """Whether what is there to be read by people tells what the hashes are of."""
    wrong: List[str] = []
    for name in sorted(n for n in names if n.startswith("raw/") and n.endswith(".csv")):
        source = name[: -len("csv")] + "columns"
        wrong += [] if source in names and _same_table(read(name), columns_of(read(source))) else [name]
    wrong += [
        f"raw/{row['chain_index']}.csv"
        for row in chain["links"]
        if f"raw/{row['chain_index']}.columns" in names and f"raw/{row['chain_index']}.csv" not in names
    ]
    report.add("raw/N.csv tell what raw/N.columns hold", not wrong, ", ".join(wrong))
    content = read("event.json")
    document, elements = json.loads(content), json.loads(read("edr.json"))
    same = [
        elements.get("event_sha256") == hashlib.sha256(content).hexdigest(),
        elements.get("t0_s") == document["event"]["t0_s"],
        elements.get("device_id") == document["subject"]["device_id"] == chain["device_id"],
        elements.get("elements")
        == [{**row, "values": row["values"] if row["recorded"] else "not recorded"} for row in document["edr"]],
    ]
    report.add("edr.json tells what event.json tells", all(same))
    told = list(csv.reader(io.StringIO(read("edr.csv").decode(), newline="")))
    report.add("edr.csv tells what event.json tells", told == list(_edr_rows(document["edr"])))


def _edr_rows(elements: List[Dict[str, Any]]) -> Iterator[List[str]]:
    """The table of elements as it must read: one row for each value."""
    yield ["table", "element", "unit", "time_s", "value", "low95", "high95", "note"]
    for row in elements:
        head = [row["table"], row["name"], row["unit"]]
        interval = ["", ""] if row["interval95"] is None else [str(end) for end in row["interval95"]]
        for time, value in zip(row["times_s"] or [""] * len(row["values"]), row["values"]):
            yield [*head, str(time), str(value), *interval, row["note"]]
        if not row["recorded"]:
            yield [*head, "", "not recorded", "", "", row["note"]]


def _same_table(text: bytes, columns: Dict[str, Tuple[float, ...]]) -> bool:
    """Whether a table of text holds these columns, nothing where not sampled."""
    head, *rows = csv.reader(io.StringIO(text.decode(), newline=""))
    if head != list(columns) or any(len(values) != len(rows) for values in columns.values()):
        return False
    return all(
        len(row) == len(head) and all(_same_cell(cell, values[k]) for cell, values in zip(row, columns.values()))
        for k, row in enumerate(rows)
    )


def _same_cell(cell: str, value: float) -> bool:
    return cell == "" if math.isnan(value) else cell != "" and float(cell) == value


def _check_event(report: Report, manifest: Dict[str, Any], chain: Dict[str, Any], read: Callable[[str], bytes]) -> None:
    content = read("event.json")
    document = json.loads(content)
    hashed = hashlib.sha256(content).hexdigest()
    report.add("event.json is canonical", canonical(document) == content, hashed)
    report.add("its hash is the one in the manifest", hashed == manifest["event_sha256"], hashed)
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


def _check_seal(report: Report, chain: Dict[str, Any], read: Callable[[str], bytes], names: Set[str]) -> None:
    seal = chain["seal"]
    if seal is None:
        told = "no: the operator set neither key nor time-stamping authority, or the seal is to come"
        report.add("sealed", not names & {"seal.txt", "seal.tsr"}, told)
        report.limits.append("NOT SEALED: the chain of uploads is tied to nothing outside this archive")
        return
    _check_covered(report, chain, seal)
    message = seal_message(chain["device_id"], seal["chain_length"], seal["chain_head"])
    if seal["signature"] is not None:
        key, signature = bytes.fromhex(seal["public_key"]), bytes.fromhex(seal["signature"])
        report.add("the signature holds", signature_holds(key, message, signature), f"Ed25519 key {seal['public_key']}")
    if seal["timestamped"]:
        # Its own signature is the authority's: openssl ts -verify -data seal.txt -in seal.tsr -CAfile ROOT.pem
        inside = hashlib.sha256(message).digest() in read("seal.tsr")
        report.add("the timestamp is of this seal", inside, "see README.txt for openssl")
    report.add("seal.txt is what was sealed", read("seal.txt") == message)


def _check_covered(report: Report, chain: Dict[str, Any], seal: Dict[str, Any]) -> None:
    """Whether the seal is of this chain, as far as the archive reaches, and what it leaves out."""
    first, length, what = chain["first_index"], seal["chain_length"], "the seal is one of this chain"
    heads = {first: chain["anchor"], **{row["chain_index"] + 1: row["chain_sha256"] for row in chain["links"]}}
    if length < first:
        report.add(what, True, f"sealed at link {length - 1}, before this archive begins; not covered")
    else:
        report.add(what, heads.get(length) == seal["chain_head"], f"link {length - 1}")
    left = [str(index) for index in chain["needed"] if index >= length]
    if left:
        report.limits.append(f"NOT SEALED YET: uploads {', '.join(left)}, on which the event rests")


def check_zip(place: Path, key: Optional[str] = None) -> Report:
    """All checks of an archive in one file; one that is none, or too damaged to be opened, says so."""
    try:
        with zipfile.ZipFile(place) as archive:
            return check(archive.read, archive.namelist(), key)
    except Exception as error:  # noqa: BLE001  as above: zipfile raises some ten kinds
        report = Report()
        report.add("the archive can be read", False, f"{type(error).__name__}: {error}")
        return report


def main(arguments: List[str]) -> int:
    """Check a folder or an archive and say so."""
    words, key = list(arguments[1:]), None
    if "--key" in words:
        at = words.index("--key")
        key = "".join(words[at + 1 : at + 2])
        del words[at : at + 2]
    place = Path(words[0]) if words else Path(__file__).resolve().parent
    if place.is_dir():
        names = sorted(
            p.relative_to(place).as_posix() for p in place.rglob("*") if p.is_file() and "__pycache__" not in p.parts
        )
        report = check(lambda name: (place / name).read_bytes(), names, key)
    else:
        report = check_zip(place, key)
    for line in report.lines:
        mark = "  ok    " if line["passed"] else "  WRONG "
        print(mark + line["check"] + (f": {line['detail']}" if line["detail"] else ""))
    for limit in report.limits:
        print("  note  " + limit)
    print("Everything holds." if report.passed else "SOMETHING DOES NOT HOLD.")
    return 0 if report.passed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv))
