"""Draws the light of a method with the real client: composites of any number of lights, and what its frames cost."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.benchmark.client_page import RASTERISERS
from nearfield_server.benchmark.gpu_process import process_ids_of, thread_time_ns
from nearfield_server.benchmark.method_packets import MethodPackets
from nearfield_server.benchmark.methods.light import ClientForm, MethodLight
from nearfield_server.benchmark.transfer_forms import PRESET
from nearfield_server.evaluation.browser import ClientPage, open_client
from nearfield_server.evaluation.page_server import serve_bundle
from nearfield_server.records import RoomMesh
from nearfield_server.scene.room_config import RoomConfig

RASTERISER: Final = "llvmpipe"
"""Two to three times faster than SwiftShader, which leaves time for more methods."""
SCALE: Final = 0.5
"""Composites are drawn in the size of the truth, half of the calibrated one."""


@dataclass(slots=True)
class MethodViews:
    """The open page of one room, whose objects have one form of transfer.

    Attributes:
        client: the page.
        packets: writes what it is sent.
        gpu_process: id of the process that draws.
        num_objects: of the room.
    """

    client: ClientPage
    packets: MethodPackets
    gpu_process: int
    num_objects: int

    def use(self, form: ClientForm) -> None:
        """Switch the parts of the renderer that a method has or lacks."""
        self.client.change_method(
            {
                "indirectOcclusion": form.indirect_exchange,
                "fixtureRays": form.fixture_rays,
                "roomShadows": form.room_shadows,
                "receiverRatio": form.receiver_ratio,
            }
        )

    def composite(self, view_index: int, light: MethodLight, *, full_quality: bool) -> NDArray[np.float64]:
        """Linear picture (H, W, 3) at half size.

        With more than 64 lights: the unlit picture plus what each turn of 64 adds to it. A real surface that a single turn darkens
        below zero is clamped there, as one with all lights would be.
        """
        turns = self.packets.turns(light)
        pictures = [self._draw(view_index, packet, full_quality) for packet in turns]
        if len(pictures) == 1:
            return pictures[0]
        unlit = self._draw(view_index, self.packets.dark(self.num_objects), full_quality)
        return np.asarray(np.maximum(unlit + sum(picture - unlit for picture in pictures), 0.0))

    def frame_cpu_ms(self, view_index: int, lights: Sequence[MethodLight]) -> float:
        """CPU milliseconds of the GPU process for one frame in live quality at calibrated size, after new light has arrived.

        A frame draws at most 16 shadow maps, and only those of lights that moved: lights that stand still are cheaper. More than 64
        lights take a frame per turn.

        Args:
            view_index: which view.
            lights: one per frame.
        """
        packets = [packet for light in lights for packet in self.packets.turns(light)]
        # The first frame may still compile or allocate.
        self.client.draw_frames(view_index, packets[:1])
        fresh = [packet for light in lights for packet in self.packets.turns(light)]
        started = thread_time_ns(self.gpu_process)
        self.client.draw_frames(view_index, fresh)
        return (thread_time_ns(self.gpu_process) - started) * 1e-6 / len(lights)

    def _draw(self, view_index: int, packet: bytes, full_quality: bool) -> NDArray[np.float64]:
        self.client.apply_light(packet)
        picture = self.client.composite(view_index, full_quality=full_quality, scale=SCALE)
        return picture[..., :3].astype(np.float64)


@contextmanager
def open_views(
    room: RoomConfig, mesh: RoomMesh, num_texels: int, say: Callable[[str], None]
) -> Iterator[MethodViews]:
    """Serve a room and open its page.

    Args:
        room: with the models of one form of transfer.
        mesh: of the room.
        num_texels: of its atlas.
        say: told what is being done.

    Raises:
        ServiceError: the client is not built, there is no browser, or the page fails.
    """
    with (
        serve_bundle(room, mesh, num_texels, None, preset=PRESET, progress=lambda text: None) as url,
        open_client(url, RASTERISERS[RASTERISER]) as client,
    ):
        session = client.devtools_session()
        (gpu_process,) = process_ids_of(session, "GPU")
        session.detach()
        say(f"  {client.browser_name}, {RASTERISER}")
        yield MethodViews(
            client=client,
            packets=MethodPackets(mesh),
            gpu_process=gpu_process,
            num_objects=len(room.objects),
        )
