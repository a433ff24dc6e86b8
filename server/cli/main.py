"""`scatola`: the arguments of every command; what a command does is imported when it runs.

Status 0 with a result, 1 with one clear line on standard error for bad data, 2 on bad usage.
"""

from __future__ import annotations

import argparse
import datetime as dt
import importlib
import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

ROUTES = ("urban", "highway", "straight", "gentle", "roundabout", "static")
METHODS = ("whole-drive", "online", "mekf", "two-phase")
VEHICLE_CLASSES = ("car", "van", "truck", "bus", "motorcycle")

Add = Callable[[str, str, str], argparse.ArgumentParser]


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit status."""
    args = build_parser().parse_args(argv)
    # Before numpy is imported: our matrices are small, and threads for them only spin on the cores of other processes.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    module, function = args.command
    command: Callable[[argparse.Namespace], int] = getattr(importlib.import_module(module), function)
    try:
        return command(args)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        return 0
    except ModuleNotFoundError as error:
        print(f"scatola: {error.name} is not installed; pip install 'scatola[server]' brings it", file=sys.stderr)
        return 1
    except Exception as error:
        # Bad data, a wrong setting, a server that does not answer are the caller's to mend: one line, no traceback.
        said = explained(error)
        if said is None:
            raise
        print(f"scatola: {said}", file=sys.stderr)
        return 1


def explained(error: Exception) -> str | None:
    """What the caller can mend, in one line; None where it is a mistake of ours."""
    package, kind = type(error).__module__.partition(".")[0], type(error).__name__
    if package == "pydantic_core" and getattr(error, "title", None) == "Settings":
        # The value itself is not repeated: it may be a secret.
        told = [
            f"SCATOLA_{'_'.join(map(str, each['loc'])).upper()}: {each['msg']}" if each["loc"] else str(each["msg"])
            for each in cast("Any", error).errors()
        ]
        return "settings: " + "; ".join(each.removeprefix("Value error, ") for each in told)
    if isinstance(error, ValueError | OSError):
        return str(error)
    if package == "sqlalchemy" and kind in _OUTSIDE:
        return f"the database: {str(getattr(error, 'orig', error)).splitlines()[0]}"
    return None


_OUTSIDE = frozenset({"OperationalError", "InterfaceError", "ProgrammingError", "ArgumentError", "NoSuchModuleError"})
"""Of SQLAlchemy: no connection, no schema, no such address; all else is a mistake of ours."""


def numbers(*counts: int) -> Callable[[str], list[float]]:
    """Type of an argument that is one of these counts of numbers, separated by commas."""

    def parse(text: str) -> list[float]:
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if len(values) not in counts or not all(math.isfinite(value) for value in values):
            wanted = " or ".join(str(count) for count in counts)
            raise argparse.ArgumentTypeError(f"{text!r}: {wanted} numbers separated by commas are needed")
        return values

    return parse


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = argparse.ArgumentParser(prog="scatola", description="Telemetry black boxes: mounting, crashes, fleet.")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    def add(name: str, target: str, summary: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=summary, description=summary)
        module, function = target.split(":")
        command.set_defaults(command=(f"server.cli.{module}", function))
        return command

    _add_file_commands(add)
    _add_sensor_commands(add)
    _add_service_commands(add)
    return parser


def _add_file_commands(add: Add) -> None:
    mount = add("mount", "files:mount", "Estimate how the box of a drive file is mounted.")
    mount.add_argument(
        "drive", type=Path, metavar="DRIVE", help="drive file; docs/device-protocol.md lists the formats"
    )
    mount.add_argument("--method", choices=METHODS, default="whole-drive")
    mount.add_argument("--traffic-side", choices=("left", "right"), help="where the traffic keeps, if known")
    mount.add_argument("--json", action="store_true", help="print the contract's JSON")

    crash = add("crash", "crash:crash", "Find and reconstruct the crashes and other events of a drive file.")
    crash.add_argument("drive", type=Path, metavar="DRIVE")
    crash.add_argument(
        "--mount",
        type=Path,
        metavar="MOUNT.json",
        help="what `mount --json` printed; default: from the drive itself",
    )
    crash.add_argument("--vehicle-class", choices=VEHICLE_CLASSES, default="car", help="default: %(default)s")
    crash.add_argument("--json", action="store_true", help="print the contract's JSON")

    simulate = add("simulate", "files:simulate", "Write a simulated drive and its exact truth.")
    simulate.add_argument("out", type=Path, metavar="OUT", help="drive file to write: .csv or .parquet")
    simulate.add_argument("--route", choices=ROUTES, default="urban")
    simulate.add_argument("--minutes", type=float, default=5.0)
    simulate.add_argument(
        "--mount", type=numbers(3), metavar="THETA,PHI,PSI", help="mounting angles in degrees; default: drawn"
    )
    simulate.add_argument("--seed", type=int, default=0)
    simulate.add_argument("--rate", type=float, default=200.0, help="accelerometer rate, Hz")
    simulate.add_argument("--gps-rate", type=float, default=4.0, help="fixes per second")
    simulate.add_argument("--gyro", action="store_true", help="the box has a gyro")
    simulate.add_argument(
        "--crash",
        action="append",
        default=[],
        type=numbers(3, 4),
        metavar="T,DV_KMH,PDOF_DEG[,MS]",
        help="an impact; may be repeated",
    )
    simulate.add_argument(
        "--move",
        action="append",
        default=[],
        type=numbers(4),
        metavar="T,X,Y,Z",
        help="at T seconds the box is turned by this rotation vector about its own axes, degrees; may be repeated",
    )
    simulate.add_argument("--json", action="store_true", help="print the truth")

    navigate = add("navigate", "navigate:navigate", "Track of a drive from GPS and inertial sensors, through outages.")
    navigate.add_argument("drive", type=Path, metavar="DRIVE")
    navigate.add_argument("--out", type=Path, required=True, metavar="TRACK", help="track to write: .csv or .parquet")
    navigate.add_argument(
        "--mount",
        type=Path,
        metavar="MOUNT.json",
        help="what `mount --json` printed; default: from the drive itself",
    )
    navigate.add_argument(
        "--pulses",
        type=Path,
        metavar="CSV",
        help="column t: box times of the receiver's pulse per second; dates the track and tells how late fixes arrive",
    )
    navigate.add_argument("--forward", action="store_true", help="no smoothing: each moment knows only its past")
    navigate.add_argument("--plot", type=Path, metavar="FIGURE", help="write a figure: .png, .svg or .pdf")
    navigate.add_argument("--json", action="store_true")

    _add_upload(add)


def moment(text: str) -> dt.datetime:
    """Type of an argument that is a time; UTC unless it says otherwise."""
    try:
        found = dt.datetime.fromisoformat(text)
        return (found.replace(tzinfo=dt.UTC) if found.tzinfo is None else found).astimezone(dt.UTC)
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError(f"{text!r} is no time such as 2026-03-01T12:00Z") from None


def _add_export(add: Add) -> None:
    export = add("export", "export:export", "Take out tracks, events or samples of a time as one Parquet file.")
    export.add_argument("kind", choices=("tracks", "events", "samples"))
    export.add_argument("out", type=Path, metavar="OUT.parquet")
    export.add_argument("--organisation", metavar="ID", help="needed where there are several")
    export.add_argument("--device", metavar="ID", help="one box alone; default: all")
    export.add_argument("--from", dest="since", type=moment, metavar="TIME", help="ISO 8601, UTC unless it says")
    export.add_argument("--to", dest="until", type=moment, metavar="TIME", help="same; not included")
    export.add_argument("--json", action="store_true")


def _add_upload(add: Add) -> None:
    upload = add("upload", "upload:upload", "Upload a drive file as a box would; resumes where it stopped.")
    upload.add_argument("drive", type=Path, nargs="?", metavar="DRIVE", help="default: send what is queued already")
    upload.add_argument("--url", help="address of the service")
    upload.add_argument("--token", help="the box's token; default: the variable SCATOLA_DEVICE_TOKEN")
    upload.add_argument("--sign-as", metavar="DEVICE", help="the box's id: sign each request, do not send the token")
    upload.add_argument("--boot", help="name of this run of the box's clock; default: from the file's content")
    upload.add_argument("--seconds", type=float, default=60.0, help="length of a batch")
    upload.add_argument("--stream", choices=("continuous", "burst"), default="continuous")
    upload.add_argument(
        "--encoding",
        choices=("parquet", "compact", "json", "csv", "arrow"),
        default="parquet",
        help="compact: the small binary form, rounded to a sensor's resolution; the others are exact",
    )
    upload.add_argument("--queue", type=Path, metavar="FOLDER", help="queue on disk; default: a state folder")
    upload.add_argument("--queue-limit-mb", type=float, default=1024.0, help="refuse to queue more than this")
    upload.add_argument("--store-only", action="store_true", help="queue the file and send nothing")
    upload.add_argument("--give-up-after", type=float, metavar="S", help="stop after waiting so long; default: never")
    upload.add_argument("--json", action="store_true")


def _add_sensor_commands(add: Add) -> None:
    allan = add("allan", "allan:allan", "Allan deviation and noise coefficients of a recording at rest.")
    allan.add_argument("file", type=Path, metavar="FILE", help="columns t and any of f*, w*, m*; CSV or Parquet")
    allan.add_argument("--rate", type=float, help="samples per second where the stamps do not tell")
    allan.add_argument("--shortest", type=float, default=0.0, help="s, cluster time from which the terms are fitted")
    allan.add_argument("--terms", default="NBK", help="coefficients to fit, of N, B, K, Q; default: %(default)s")

    calibrate = add("calibrate", "calibrate:calibrate", "Calibrate an accelerometer, gyro or magnetometer.")
    calibrate.add_argument("sensor", choices=("accel", "gyro", "mag"))
    calibrate.add_argument("file", type=Path, metavar="FILE", help="columns t and f*, w* or m*; CSV or Parquet")
    calibrate.add_argument(
        "--reference",
        type=Path,
        metavar="FILE",
        help="the true input: columns t and f*, w* or m*, or roll_deg, pitch_deg, yaw_deg; CSV",
    )
    calibrate.add_argument("--poses", action="store_true", help="each row is the mean of one pose")
    calibrate.add_argument("--gravity", type=float, default=9.80665, help="local, m/s²; default: %(default)s")
    calibrate.add_argument(
        "--speeds", type=numbers(1, 2, 3, 4), metavar="DEG_PER_S[,...]", help="gyro: rates of the turntable used"
    )
    calibrate.add_argument(
        "--field", type=numbers(1, 3), metavar="UT|N,E,D", help="mag: true field, its magnitude or vector, µT"
    )
    calibrate.add_argument("--window", type=float, default=1.0, help="s, over which rest is told; default: 1")
    align = add("align", "align:align", "Level a box at its longest rest in a file, and find its heading where it can.")
    align.add_argument("file", type=Path, metavar="FILE", help="drive file: CSV or Parquet")
    align.add_argument("--lat", type=float, metavar="DEG", help="latitude; default: from the file's fixes")
    align.add_argument("--lon", type=float, metavar="DEG", help="longitude, same")
    align.add_argument("--height", type=float, metavar="M", help="height, same")
    align.add_argument("--year", type=float, help="decimal year for the magnetic field; default: from the file's utc")
    align.add_argument("--accel-bias-mg", type=float, default=5.0, help="1-sigma of the accelerometer's bias")
    align.add_argument("--gyro-bias-deg-per-hour", type=float, default=360.0, help="1-sigma of the gyro's bias")
    align.add_argument("--field-sigma-ut", type=float, default=1.0, help="1-sigma of the magnetometer")
    align.add_argument("--heading-limit-deg", type=float, default=5.0, help="largest 1-sigma of a heading of use")
    align.add_argument(
        "--by-hand", action="store_true", help="only check that an axis is upright, and list the four mountings left"
    )
    align.add_argument("--tolerance", type=float, default=0.05, metavar="G", help="of that check")
    align.add_argument(
        "--forward-axis",
        choices=("+x", "-x", "+y", "-y", "+z", "-z"),
        help="choose among the four by the axis of the box that points forward, as --forward-axis=-x",
    )
    for command in (allan, calibrate, align):
        command.add_argument("--json", action="store_true")
        command.add_argument("--plot", type=Path, metavar="IMAGE", help="write a figure: .png, .svg or .pdf")


def _add_reprocess(add: Add) -> None:
    reprocess = add(
        "reprocess", "reprocess:reprocess", "Compute severe events or mountings again by this version, and compare."
    )
    reprocess.add_argument(
        "--mountings", action="store_true", help="mountings of another version instead of events; again goes on"
    )
    reprocess.add_argument("--device", metavar="ID", help="one box alone; default: all")
    reprocess.add_argument("--jobs", type=int, default=1, help="processes that share the work; default: %(default)s")
    reprocess.add_argument("--resume", metavar="RUN", help="go on with a run that was stopped")
    reprocess.add_argument("--report", metavar="RUN", help="only show a run, as far as it has come")
    reprocess.add_argument("--json", action="store_true")


def _add_service_commands(add: Add) -> None:
    add("serve", "processes:serve", "Serve the API and the pages; without a broker also worker and 3D viewer.")
    add("worker", "processes:worker", "Work off what is due.")
    viewer = add("viewer", "processes:viewer", "Serve the 3D views.")
    viewer.add_argument("--host", default="127.0.0.1")
    viewer.add_argument("--port", type=int, default=8001)
    migrate = add("migrate", "processes:migrate", "Bring the database to the newest schema.")
    migrate.add_argument("--check", action="store_true", help="only say whether migrations and models agree")
    verify = add(
        "verify", "verify:verify", "Recompute the chain of evidence of boxes, or check an archive of evidence."
    )
    verify.add_argument(
        "archive", type=Path, nargs="?", metavar="EVIDENCE.zip", help="default: this installation's data"
    )
    verify.add_argument("--device", metavar="ID", help="one box alone; default: all")
    verify.add_argument("--key", metavar="HEX", help="public key that must have signed the archive")
    verify.add_argument("--json", action="store_true")
    _add_reprocess(add)
    erase = add("erase", "erase:erase", "Erase what is held about a vehicle or a person; prints a certificate.")
    erase.add_argument("kind", choices=("vehicle", "user"))
    erase.add_argument("id", metavar="ID")
    erase.add_argument("--reason", help="stands in the certificate")
    erase.add_argument("--from", dest="since", metavar="TIME", help="a vehicle's data from then on; default: all")
    erase.add_argument("--to", dest="until", metavar="TIME", help="a vehicle's data until then; default: all")
    erase.add_argument("--dry-run", action="store_true", help="only say what would be erased and what would be kept")
    erase.add_argument("--json", action="store_true")
    back = add("backup", "backup:backup", "Back up database and blobs into a folder, beside a running service.")
    back.add_argument("out", type=Path, metavar="OUT", help="folder to make")
    back.add_argument("--json", action="store_true")
    bring = add("restore", "backup:restore", "Bring a backup back into an empty installation, SQLite or PostgreSQL.")
    bring.add_argument("source", type=Path, metavar="IN", help="folder that backup made")
    bring.add_argument("--json", action="store_true")
    doctor = add("doctor", "doctor:doctor", "Look at everything this installation rests on; status 1 at a fault.")
    doctor.add_argument("--json", action="store_true")
    _add_export(add)
    letters = add("dead-letters", "dead_letters:dead_letters", "Boxes whose work keeps failing; try them again.")
    letters.add_argument("--replay", metavar="DEVICE", action="append", help="try a box again now; may be repeated")
    letters.add_argument("--replay-all", action="store_true", help="try all dead letters again now")
    letters.add_argument("--json", action="store_true")
    demo = add("demo", "demo:demo", "The service and a simulated fleet that uploads to it.")
    demo.add_argument("--speed", type=float, default=30.0, help="how much faster than life the past is replayed")
    demo.add_argument("--history-minutes", type=float, default=40.0, help="how far back the fleet begins")
    fleet = add("demo-fleet", "demo:fleet", "The simulated fleet alone (started by demo).")
    fleet.add_argument("--url", required=True)
    fleet.add_argument("--speed", type=float, default=30.0)
    fleet.add_argument("--history-minutes", type=float, default=40.0)
    analysis = add("analysis", "processes:analysis", "Do one analysis of the workbench (started by the worker).")
    analysis.add_argument("id")
    analysis.add_argument("attempt", type=int)
    add("warm-up", "processes:warm_up", "Compile the numerical kernels into the cache.")


if __name__ == "__main__":
    sys.exit(main())
