from __future__ import annotations

import datetime as dt
from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

from server.accounts.permissions import Permission

Role = Literal["admin", "manager", "installer", "claims", "reader"]
Email = Annotated[str, Field(min_length=3, max_length=254, pattern=r"^[^@\s\x00-\x1f]+@[^@\s\x00-\x1f]+$")]
Password = Annotated[str, Field(max_length=200)]
Code = Annotated[str, Field(max_length=20)]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)


class SignIn(BaseModel):
    model_config = ConfigDict(extra="forbid")

    code: str | None = Field(
        default=None, min_length=1, max_length=500, description="one-time code, or the administrator's token"
    )
    email: str | None = Field(default=None, max_length=254)
    password: Password | None = None
    totp: Code = Field(default="", description="of the authenticator, where one is set up")

    @model_validator(mode="after")
    def _one_way(self) -> SignIn:
        if (self.code is None) == (self.email is None or self.password is None):
            raise ValueError("either code, or email and password")
        return self


class SessionOut(BaseModel):
    csrf_token: str = Field(description="to be sent as X-CSRF-Token with every request that changes something")


class OpenedSessionOut(SessionOut):
    expires_at: dt.datetime = Field(description="moves on while the session is used")


class AccountOut(BaseModel):
    name: str
    user_id: str | None
    organisation_id: str
    permissions: list[str]


class NewPassword(BaseModel):
    model_config = ConfigDict(extra="forbid")

    current: Password = Field(default="", description="not asked of whoever came with a one-time code")
    new: Password


class TotpBegun(BaseModel):
    secret: str
    uri: str


class TotpCode(Strict):
    code: Code


class UserIn(Strict):
    email: Email
    name: str = Field(min_length=1, max_length=200)
    role: Role


class UserChange(Strict):
    name: str | None = Field(default=None, min_length=1, max_length=200)
    role: Role | None = None
    disabled: bool | None = None


class UserOut(BaseModel):
    model_config = ConfigDict(from_attributes=True)

    id: str
    email: str
    name: str
    role: Role
    totp_confirmed: bool
    created_at: dt.datetime
    disabled_at: dt.datetime | None
    signed_in_at: dt.datetime | None
    locked_until: dt.datetime | None


class SignInCodeOut(BaseModel):
    code: str = Field(description="shown once; opens a session within a day, at /login?code=...")


class NewUserOut(UserOut, SignInCodeOut):
    pass


class ApiKeyIn(Strict):
    name: str = Field(min_length=1, max_length=200)
    scopes: list[Permission] = Field(min_length=1, max_length=20)
    expires_at: AwareDatetime | None = None


class ApiKeyOut(BaseModel):
    model_config = ConfigDict(from_attributes=True)

    id: str
    name: str
    scopes: list[str]
    created_at: dt.datetime
    expires_at: dt.datetime | None
    revoked_at: dt.datetime | None


class NewApiKeyOut(ApiKeyOut):
    key: str = Field(description="shown once; a bearer token")


class AuditOut(BaseModel):
    model_config = ConfigDict(from_attributes=True)

    id: int
    at: dt.datetime
    actor_kind: str
    actor_id: str | None
    actor_name: str
    action: str
    subject: str
    detail: dict[str, Any]
    address: str


class AuditPage(BaseModel):
    items: list[AuditOut]
    next: int | None = Field(description="value of `before` for the next page")


class OrganisationIn(Strict):
    name: str = Field(min_length=1, max_length=200)
    administrator: UserIn


class OrganisationOut(BaseModel):
    model_config = ConfigDict(from_attributes=True)

    id: str
    name: str
    created_at: dt.datetime


class NewOrganisationOut(OrganisationOut):
    administrator: NewUserOut
