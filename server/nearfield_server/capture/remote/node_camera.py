"""The process of one camera of a node: captures into a ring of its own, from which a thread sends. Started by `nearfield capture`."""

from __future__ import annotations

import os
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.bus.worker import Worker, run_worker
from nearfield_server.capture.cameras import SourcePlan, build_source
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.process import FramePump, capture_loop
from nearfield_server.capture.remote.certificates import CertificateFiles
from nearfield_server.capture.remote.node_link import NodeLink
from nearfield_server.capture.remote.reduce import reduce_picture
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.capture.source import RawFrame, Source
from nearfield_server.scene.node_config import NodeConfig, load_node


class NodeSource:
    """A source whose pictures are made smaller, and whose lights follow what the service says.

    Args:
        source: the camera.
        shape: height and width of its pictures, pixels.
        factor: pixels of the source per pixel sent, in each direction.
    """

    def __init__(self, source: Source, shape: tuple[int, int], factor: int) -> None:
        self._source, self._factor = source, factor
        self._small = np.zeros((shape[0] // factor, shape[1] // factor, 4), np.float32)
        self._revision: int | None = None
        self.link: NodeLink | None = None

    def open(self) -> None:
        """Open the camera."""
        self._revision = None
        self._source.open()

    def close(self) -> None:
        """Close the camera."""
        self._source.close()

    def set_light_weights(self, weights: tuple[float, ...]) -> None:
        """Dim the lights of a simulated camera."""
        self._source.set_light_weights(weights)

    def wait_for_frame(self, stop: threading.Event, period_s: float) -> None:
        """Wait as the camera does."""
        self._source.wait_for_frame(stop, period_s)

    def next_frame(self, now_ns: int) -> RawFrame | None:
        """Return the camera's picture, made smaller."""
        weights = None if self.link is None else self.link.light_weights
        if weights:
            self._source.set_light_weights(weights)
        frame = self._source.next_frame(now_ns)
        if frame is None or self._factor == 1:
            return frame
        if frame.content_revision != self._revision:
            reduce_picture(frame.pixels, self._factor, self._small)
            self._revision = frame.content_revision
        return RawFrame(
            pixels=self._small,
            timestamp_ns=frame.timestamp_ns,
            content_revision=frame.content_revision,
            counters=frame.counters,
            metadata={**frame.metadata, "reduced": self._factor},
        )

    def describe(self) -> dict[str, Any]:
        """Describe the camera."""
        return dict(self._source.describe())


def _no_circle() -> NDArray[np.bool_] | None:
    """The node does not know the lens; the service leaves out what lies outside the image circle."""
    return None


def main(worker: Worker) -> None:
    """Capture and send one camera until told to stop."""
    node = load_node(worker.spec.room_path)
    index = int(worker.spec.options["camera_index"])
    camera = node.cameras[index]
    shape = RingShape(camera.height // camera.reduce, camera.width // camera.reduce)
    source = NodeSource(
        build_source(_plan(node, index, worker.spec.options.get("sensor"))),
        (camera.height, camera.width),
        camera.reduce,
    )
    ring_fd, signal_fd = create_ring(camera.camera_id, shape), FrameSignal.create()
    signal = FrameSignal(signal_fd)
    ring = FrameRingWriter(ring_fd, camera.camera_id, shape)
    reader = FrameRingReader(ring_fd, camera.camera_id, shape)
    pump = FramePump(source, ring, signal, _no_circle(), camera.change_tolerance)

    def describe() -> tuple[str, dict[str, Any]]:
        status = worker.status()
        return str(status.get("fault", "")), dict(status.get("source", {}))

    files = CertificateFiles.in_folder(node.certificates, node.node)
    link = NodeLink(node, camera, files, reader, signal, describe)
    source.link = link
    worker.describe(lambda: {"link": link.status()})
    link.start()
    try:
        capture_loop(
            worker,
            pump,
            node.frame_rate,
            lambda: {"camera_id": camera.camera_id, "source": source.describe()},
        )
    finally:
        link.close()
        ring.close()
        reader.close()
        os.close(ring_fd)
        os.close(signal_fd)


def _plan(node: NodeConfig, index: int, sensor: dict[str, float] | None) -> SourcePlan:
    camera = node.cameras[index]
    return SourcePlan(
        camera_id=camera.camera_id,
        camera_index=index,
        config=camera.source,
        height=camera.height,
        width=camera.width,
        frame_rate=node.frame_rate,
        lights=node.lights,
        sensor=sensor,
    )


if __name__ == "__main__":
    run_worker(main)
