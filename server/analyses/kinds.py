"""What the workbench can analyse, and what each kind may be told; no numerics here, the API reads it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from server.errors import InvalidError

Kind = Literal["allan", "accelerometer", "gyro", "magnetometer", "track", "mounting"]
KINDS: tuple[Kind, ...] = get_args(Kind)
WITH_PLACES: frozenset[Kind] = frozenset({"track"})
"""Kinds whose results tell where a vehicle was."""
Method = Literal["mekf", "two-phase", "online", "whole-drive"]

Positive = Annotated[float, Field(gt=0.0, le=1e6, allow_inf_nan=False)]


class _Parameters(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Allan(_Parameters):
    """Allan deviation of every axis at rest."""

    terms: Annotated[str, Field(pattern="^[NBKQ]{1,4}$")] = "NBK"
    rate_hz: Positive | None = None
    """Take the samples as regular at this rate, whatever their stamps say."""
    shortest_s: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    """Cluster time from which the terms are fitted."""


class Accelerometer(_Parameters):
    """Accelerometer from poses at rest."""

    gravity_mps2: Annotated[float, Field(ge=9.7, le=9.9)] = 9.80665
    window_s: Annotated[float, Field(ge=0.1, le=60.0)] = 1.0
    """Over which rest is told."""
    rows_are_poses: bool = False
    """Each row is the mean of one pose."""


class Gyro(_Parameters):
    """Gyro on a turntable of known rates."""

    rates_deg_s: Annotated[list[Positive], Field(min_length=1, max_length=8)]
    window_s: Annotated[float, Field(ge=0.1, le=60.0)] = 1.0
    rows_are_poses: bool = False


class Magnetometer(_Parameters):
    """Hard and soft iron from any motion all around."""

    field_ut: Positive | None = None
    """Magnitude of the true field, where it is known."""


class Track(_Parameters):
    """Track from GPS and inertial sensors, with GPS withheld for a while."""

    outage_from_s: Annotated[float, Field(allow_inf_nan=False)] | None = None
    """On the box's clock; without it, in the middle of the fixes."""
    outage_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 30.0
    """How long; 0 withholds nothing."""
    smoothed: bool = True


class Mounting(_Parameters):
    """Estimators of the mounting side by side."""

    methods: Annotated[list[Method], Field(min_length=1, max_length=4)] = ["mekf", "two-phase", "online", "whole-drive"]
    traffic_side: Literal["left", "right"] | None = None

    @model_validator(mode="after")
    def _once(self) -> Mounting:
        if len(set(self.methods)) != len(self.methods):
            raise ValueError("each method once")
        return self


_WORDS = ("terms", "traffic_side")
PARAMETERS: dict[Kind, type[_Parameters]] = {
    "allan": Allan,
    "accelerometer": Accelerometer,
    "gyro": Gyro,
    "magnetometer": Magnetometer,
    "track": Track,
    "mounting": Mounting,
}


def from_form(kind: Kind, typed: Mapping[str, str]) -> dict[str, Any]:
    """The parameters of a kind from a form, in which empty fields leave the default and commas may be decimal."""
    given: dict[str, Any] = {}
    for name, field in PARAMETERS[kind].model_fields.items():
        text = typed.get(name, "").strip()
        if field.annotation is bool:
            given[name] = bool(text)
        elif text and name == "rates_deg_s":
            given[name] = text.replace(";", " ").replace(", ", " ").split()
        elif text:
            given[name] = text if name in _WORDS else text.replace(",", ".")
    return _told(lambda: PARAMETERS[kind].model_validate(given))


def checked(kind: Kind, given: str) -> dict[str, Any]:
    """The parameters of a kind from JSON text, defaults filled in."""
    return _told(lambda: PARAMETERS[kind].model_validate_json(given))


def _told(validated: Callable[[], _Parameters]) -> dict[str, Any]:
    try:
        return validated().model_dump(mode="json")
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "parameters"
        raise InvalidError(f"{where}: {first['msg']}", code="parameters") from None
