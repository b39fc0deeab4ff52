"""Serves the scene of a bundle with one light packet, as the service would, and renders its views with the real client."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from nearfield_server.errors import ServiceError
from nearfield_server.evaluation.browser import ClientPictures, take_pictures
from nearfield_server.evaluation.light_run import LightRun
from nearfield_server.gateway.app import create_app
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.pages import BUILT_CLIENT
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
    with serve_bundle(
        room,
        mesh,
        len(texels.texel_index),
        run.packet_bytes,
        preset=preset,
        progress=progress,
        static_dir=static_dir,
    ) as url:
        progress(f"rendering {len(view_indices)} views in the browser")
        return take_pictures(url, view_indices, run.packet.sequence)


@contextmanager
def serve_bundle(
    room: RoomConfig,
    mesh: RoomMesh,
    num_texels: int,
    packet: bytes | None,
    *,
    preset: str,
    progress: Callable[[str], None],
    static_dir: Path = BUILT_CLIENT,
) -> Iterator[str]:
    """Serve the page and the scene of a room; yields the URL.

    Args:
        room: with the light weights that the backgrounds are mixed by.
        mesh: its model.
        num_texels: of its atlas.
        packet: that clients get, or None where they are given their light by other means.
        preset: quality of prepared objects.
        progress: called with a line of text before each step.
        static_dir: the built client.

    Raises:
        ServiceError: the client is not built.
    """
    if not (static_dir / "index.html").is_file():
        raise ServiceError(
            f"the client is not built ({static_dir / 'index.html'} is missing); run `npm ci && npm run build` in client_web, "
            "or evaluate with --no-views"
        )
    scene = build_scene(room, mesh, num_texels, preset=preset, progress=progress)
    hub = LightHub()
    if packet is not None:
        hub.publish_light(packet)
    app = create_app(scene.description, hub, NoControls(), static_dir, assets=scene.assets)
    with serve_in_thread(app) as url:
        yield url
