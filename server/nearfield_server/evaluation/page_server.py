"""Serves the scene of a bundle with one light packet, as the service would, and renders its views with the real client."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from nearfield_server.errors import ServiceError
from nearfield_server.evaluation.browser import ClientPictures, take_pictures
from nearfield_server.evaluation.light_run import LightRun
from nearfield_server.gateway.app import BUILT_CLIENT, create_app
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.ports import NoControls
from nearfield_server.gateway.scene_builder import build_scene
from nearfield_server.gateway.server import serve_in_thread
from nearfield_server.records import RoomMesh, TexelGeometry
from nearfield_server.scene.room_config import RoomConfig


def render_views(
    room: RoomConfig,
    mesh: RoomMesh,
    texels: TexelGeometry,
    run: LightRun,
    view_indices: Sequence[int],
    *,
    preset: str,
    progress: Callable[[str], None],
    static_dir: Path = BUILT_CLIENT,
) -> ClientPictures:
    """Composites of tablet views in full size, lit by the packet of `run`.

    Args:
        room: with the light weights that the backgrounds are mixed by.
        mesh: its model.
        texels: its atlas.
        run: the packet to publish.
        view_indices: which views of the room.
        preset: quality of prepared objects.
        progress: called with a line of text before each step.
        static_dir: the built client.

    Raises:
        ServiceError: the client is not built, there is no browser, or the page fails.
    """
    if not (static_dir / "index.html").is_file():
        raise ServiceError(
            f"the client is not built ({static_dir / 'index.html'} is missing); run `npm ci && npm run build` in client_web, "
            "or evaluate with --no-views"
        )
    scene = build_scene(room, mesh, len(texels.texel_index), preset=preset, progress=progress)
    hub = LightHub()
    hub.publish_light(run.packet_bytes)
    app = create_app(scene.description, hub, NoControls(), static_dir, assets=scene.assets)
    progress(f"rendering {len(view_indices)} views in the browser")
    with serve_in_thread(app) as url:
        return take_pictures(url, view_indices, run.packet.sequence)
