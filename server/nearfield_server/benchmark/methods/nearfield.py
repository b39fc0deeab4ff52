"""Nearfield's own light pipeline, as the service runs it."""

from __future__ import annotations

from dataclasses import replace

from nearfield_server.benchmark.methods.light import AtlasSample, MethodLight
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.records import ObjectPose


class Nearfield:
    """Keeps its clusters and its threshold from picture to picture."""

    def __init__(self, pipeline: LightPipeline, poses: tuple[ObjectPose, ...]) -> None:
        self._pipeline, self._poses, self._count = pipeline, poses, 0

    def extract(self, sample: AtlasSample) -> MethodLight:
        """One update with new pictures. Gathers them itself: its time includes what other methods are charged for."""
        self._count += 1
        frames = [replace(frame, content_revision=self._count) for frame in sample.frames]
        update = self._pipeline.update(frames, self._poses)
        return MethodLight(vals=update.vals, object_sh=update.object_sh)
