"""What can go wrong for a caller, as RFC 9457 problems with stable codes.

Services raise these; `server.app` turns them into ``application/problem+json``.
"""

from __future__ import annotations


class ProblemError(Exception):
    """An error that the caller can act on.

    ``code`` is stable, ``status`` the HTTP status, ``detail`` names what is wrong and where;
    ``extra`` are further members of the problem document.
    """

    status: int = 400
    code: str = "bad_request"
    title: str = "Bad request"

    def __init__(self, detail: str, *, code: str | None = None, **extra: object) -> None:
        self.detail = detail
        self.extra = extra
        if code is not None:
            self.code = code
        super().__init__(detail)


class UnauthenticatedError(ProblemError):
    status, code, title = 401, "unauthenticated", "Credentials are missing or not valid"


class ForbiddenError(ProblemError):
    status, code, title = 403, "forbidden", "Not allowed"


class NotFoundError(ProblemError):
    status, code, title = 404, "not_found", "Not found"


class SlowBodyError(ProblemError):
    status, code, title = 408, "body_timeout", "The body did not arrive in time"


class ConflictError(ProblemError):
    status, code, title = 409, "conflict", "In conflict with what is stored"


class GoneError(ProblemError):
    status, code, title = 410, "erased", "Erased"


class TooLargeError(ProblemError):
    status, code, title = 413, "too_large", "Body is too large"


class UnsupportedMediaError(ProblemError):
    status, code, title = 415, "unsupported_media_type", "Media type or encoding is not supported"


class InvalidError(ProblemError):
    status, code, title = 422, "invalid", "Content is not valid"


class TooManyRequestsError(ProblemError):
    status, code, title = 429, "too_many_requests", "Too many requests"


class FullError(ProblemError):
    status, code, title = 507, "storage_full", "No room to store this now"


class UnavailableError(ProblemError):
    status, code, title = 503, "unavailable", "Not available now"
