"""The site's files under addresses that browsers keep."""

import re

from server import static_files


def test_pages_name_files_that_are_kept_for_a_year(client):
    page = client.get("/login").text
    named = set(re.findall(r'(?:src|href)="(/static/[^"]+)"', page))
    assert named
    for path in named:
        answer = client.get(path)
        assert answer.status_code == 200
        assert path.startswith(static_files.address())
        assert answer.headers["cache-control"] == "public, max-age=31536000, immutable"


def test_another_version_gets_the_files_there_are_and_asks_again(client):
    for path in ("js/app.js", "vendor/uplot/uplot.css"):
        kept = client.get(f"{static_files.address()}/{path}")
        for other in (f"/static/v/0123456789abcdef/{path}", f"/static/{path}"):
            answer = client.get(other)
            assert answer.content == kept.content
            assert answer.headers["cache-control"] == "no-cache"
    assert client.get(f"{static_files.address()}/js/none.js").headers["cache-control"] != kept.headers["cache-control"]


def test_no_template_is_served(client):
    for path in ("templates/base.html", "vendor/../templates/base.html", "%2e%2e/templates/base.html"):
        assert client.get(f"{static_files.address()}/{path}").status_code == 404


def test_the_version_names_the_content(tmp_path, monkeypatch):
    monkeypatch.setattr(static_files, "folder", lambda _: tmp_path)
    file = tmp_path / "static" / "a.css"
    file.parent.mkdir()
    versions = set()
    for content in ("a", "b"):
        file.write_text(content)
        static_files.version.cache_clear()
        versions.add(static_files.version())
    file.rename(file.with_name("c.css"))
    static_files.version.cache_clear()
    versions.add(static_files.version())
    static_files.version.cache_clear()
    assert len(versions) == 3
