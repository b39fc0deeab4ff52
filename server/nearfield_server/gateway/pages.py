"""The built pages of the browser client, and what is shown as long as they are not built."""

from __future__ import annotations

from pathlib import Path

from fastapi import Request
from fastapi.responses import HTMLResponse, Response
from starlette.exceptions import HTTPException
from starlette.staticfiles import StaticFiles

BUILT_CLIENT = Path(__file__).resolve().parents[1] / "static"
"""Where the built client lies in a checkout and in the wheel."""

NOT_BUILT = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Nearfield</title>
<h1>The page is not built yet</h1>
<p>The server runs, but its browser client is missing. In the source tree, run
<code>npm ci &amp;&amp; npm run build</code> in <code>client_web</code> and reload this page.</p>
<p>What the server knows: <a href="api/scene">scene</a>, <a href="api/status">status</a>, <a href="metrics">metrics</a>.</p></html>
"""


class ClientFiles(StaticFiles):
    """The built client; as long as it is not built, every file of it is missing."""

    async def check_config(self) -> None:
        """Check that the folder is there."""
        if not Path(str(self.directory)).is_dir():
            raise HTTPException(404)
        await super().check_config()

    async def page(self, name: str, request: Request) -> Response:
        """One of the pages, or what to do when it is not built."""
        if not (Path(str(self.directory)) / name).is_file():
            return HTMLResponse(NOT_BUILT, status_code=503)
        response = await self.get_response(name, request.scope)
        # Names of the built scripts hold a hash of their content; the page that names them must be fresh.
        response.headers["Cache-Control"] = "no-cache"
        return response
