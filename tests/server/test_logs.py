from __future__ import annotations

import pytest

from server.logs import redact


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("amqp://scatola:hunter2@broker:5672/x", "amqp://scatola:[redacted]@broker:5672/x"),
        ('{"authorization": "Bearer abc.def"}', '{"authorization": "Bearer [redacted]"}'),
        ("Scatola-HMAC-SHA256 device=1, signature=2f", "Scatola-HMAC-SHA256 [redacted], signature=[redacted]"),
        ("key sck_0123456789abcdef is old", "key sck_[redacted] is old"),
        ("GET /login?code=s3cret&next=/", "GET /login?code=[redacted]&next=/"),
        ("cookie: scatola_session=abc; other=1", "cookie: scatola_session=[redacted]; other=1"),
        ("/view3d/abcdefghijklmnop/0123/", "/view3d/[redacted]/0123/"),
    ],
)
def test_what_looks_like_a_credential_is_struck_out(line, told):
    assert redact(line) == told


def test_the_rest_is_left_alone():
    line = '{"route": "/view3d/{ticket}/{device_id}", "event": "request", "url": "http://127.0.0.1:8000/x"}'
    assert redact(line) == line
