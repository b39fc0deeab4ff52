"""A person sets up a room: cameras are listed, looked through, chosen, and written into a room file."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from nearfield_server.capture.device import Device
from nearfield_server.errors import CaptureError, ConfigError
from nearfield_server.onboarding.connected import FREE, Connected, Listing
from nearfield_server.onboarding.lens_guess import DEFAULT_FIELD_DEGREES, default_lens, with_field
from nearfield_server.onboarding.look import Look, better_exposure
from nearfield_server.onboarding.room_file import add_cameras, create_room
from nearfield_server.onboarding.room_text import PlannedCamera, camera_ids, camera_places
from nearfield_server.onboarding.source_plan import choose_pixel_format, source_table, source_values
from nearfield_server.onboarding.viewer import Decode, Viewer, Wish
from nearfield_server.scene.device_schema import DeviceSourceTable
from nearfield_server.scene.room_config import RoomConfig

LONGEST_S = 0.1
"""Exposures that are found stay below this, seconds: ten pictures a second must be possible."""
_MOST_MODELS = 200
_MOST_STEPS = 5

OpenCamera = Callable[[Connected, DeviceSourceTable], tuple[Callable[[], Device], Decode]]
"""For a camera and its source table: what makes its device, and what turns its frames into signal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraChoice:
    """A camera that is to be in the room.

    Attributes:
        index: position in the listing.
        camera_id: name in the room.
        pixel_format: None = the best that it offers.
        exposure_s: exposure time, seconds; None = left to the camera.
        field_degrees: full angle that its lens shows.
    """

    index: int
    camera_id: str
    pixel_format: str | None = None
    exposure_s: float | None = None
    field_degrees: float = DEFAULT_FIELD_DEGREES


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomState:
    """The room file as it is now.

    Attributes:
        path: of the file.
        exists: it is there; cameras are then added to it.
        camera_ids: names of its cameras.
        places: how its cameras are found: addresses, serial numbers, device paths.
        problem: why it cannot be added to, in words; empty if it can.
    """

    path: Path
    exists: bool = False
    camera_ids: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    problem: str = ""


class SetupSession:
    """One set-up. Methods may be called from any thread; close it when done, so that no camera stays open.

    Args:
        search: lists what is connected.
        open_camera: see `OpenCamera`.
        room_path: the room file to write or to add to.
    """

    def __init__(self, search: Callable[[], Listing], open_camera: OpenCamera, room_path: Path) -> None:
        self.room_path = room_path
        self._search, self._open_camera = search, open_camera
        self._lock = threading.Lock()
        self._listing = Listing()
        self._viewers: dict[tuple[str, str, str], Viewer] = {}
        self._looks: dict[tuple[str, str], tuple[str, Look]] = {}

    def search(self) -> Listing:
        """Look for cameras (again); cameras that are being looked through are let go first, so that they are found free."""
        with self._lock:
            self._close_viewers()
            self._listing = self._search()
            return self._listing

    @property
    def listing(self) -> Listing:
        """What the last search found."""
        return self._listing

    def camera(self, index: int) -> Connected:
        """One camera of the listing.

        Raises:
            ConfigError: there is no such camera.
        """
        cameras = self._listing.cameras
        if not 0 <= index < len(cameras):
            raise ConfigError(f"camera {index}: expected one of {len(cameras)} that were found; search again")
        return cameras[index]

    def look(self, index: int, wish: Wish, pixel_format: str | None = None) -> Look:
        """Look through a camera; waits for its picture.

        Raises:
            ConfigError: there is no such camera, or it has no pixel format that can be read.
            CaptureError: it is not free, cannot be opened or sends nothing.
        """
        camera = self.camera(index)
        if camera.state != FREE:
            raise CaptureError(f"{camera.name} is {camera.state}: {camera.advice}")
        asked_format = _format_of(camera, pixel_format)
        look = self._viewer(camera, asked_format).look(wish)
        with self._lock:
            self._looks[camera.kind, camera.place] = asked_format, look
        return look

    def expose(self, index: int, pixel_format: str | None = None, *, longest_s: float = LONGEST_S) -> Look:
        """Look through a camera with the exposure that suits what it sees.

        Args:
            index: position in the listing.
            pixel_format: None = the best that it offers.
            longest_s: exposure time at most, seconds.

        Raises:
            ConfigError, CaptureError: see `look`.
        """
        look = self.look(index, Wish(), pixel_format)
        for _ in range(_MOST_STEPS):
            exposure_s = better_exposure(look, longest_s)
            if abs(exposure_s / look.exposure_s - 1.0) < 0.1:
                break
            look = self.look(index, Wish(exposure_s=exposure_s), pixel_format)
        return look

    def _viewer(self, camera: Connected, pixel_format: str) -> Viewer:
        key = (camera.kind, camera.place, pixel_format)
        with self._lock:
            viewer = self._viewers.get(key)
            if viewer is None:
                # The same camera in another format: one must be closed before the other opens.
                for other in [other for other in self._viewers if other[:2] == key[:2]]:
                    self._viewers.pop(other).close()
                make_device, decode = self._open_camera(camera, source_table(camera, pixel_format))
                viewer = self._viewers[key] = Viewer(make_device, decode)
            return viewer

    @property
    def default_name(self) -> str:
        """Name of a new room that nobody names: that of its folder."""
        return self.room_path.absolute().parent.name[:64] or "room"

    def room(self) -> RoomState:
        """The room file as it is now."""
        path = self.room_path
        if not path.exists():
            return RoomState(path=path)
        try:
            text = path.read_text(encoding="utf-8")
            return RoomState(
                path=path, exists=True, camera_ids=tuple(camera_ids(text)), places=tuple(camera_places(text))
            )
        except (OSError, UnicodeDecodeError, ConfigError) as error:
            return RoomState(path=path, exists=True, problem=f"{path}: {error}")

    def model_path(self, model: str) -> Path | None:
        """The file that one of `models` means; None for the empty text.

        Raises:
            ConfigError: it is none of them.
        """
        if not model:
            return None
        if model not in self.models():
            raise ConfigError(
                f"{model}: expected a model in the folder of the room; there are: {', '.join(self.models()) or 'none'}"
            )
        return self.room_path.absolute().parent / model

    def models(self) -> tuple[str, ...]:
        """GLB files in the folder of the room and the folders in it, relative to it; those that are called room come first."""
        folder = self.room_path.absolute().parent
        found = [path for pattern in ("*.glb", "*/*.glb") for path in folder.glob(pattern) if path.is_file()]
        found.sort(key=lambda path: ("room" not in path.name.lower(), path))
        return tuple(path.relative_to(folder).as_posix() for path in found[:_MOST_MODELS])

    def plan(self, choices: Sequence[CameraChoice]) -> list[PlannedCamera]:
        """Tables for the chosen cameras: lenses from the last looks, else defaults from the size of their pictures.

        Raises:
            ConfigError: a camera is none of the listing, or its picture size is not known.
        """
        return [self._planned(choice) for choice in choices]

    def _planned(self, choice: CameraChoice) -> PlannedCamera:
        camera = self.camera(choice.index)
        pixel_format = _format_of(camera, choice.pixel_format)
        seen_format, look = self._looks.get((camera.kind, camera.place), (None, None))
        width, height = camera.size_of(pixel_format)
        if look is not None and seen_format == pixel_format:
            lens = with_field(look.lens, choice.field_degrees)
        elif width > 0 and height > 0:
            look, lens = None, default_lens(width, height, choice.field_degrees)
        else:
            raise ConfigError(f"{camera.name}: the size of its picture is not known; look through it first")
        found = (
            "found in its picture"
            if look is not None and look.has_circle
            else "not found: middle and width of the picture"
        )
        remarks = (
            f"{camera.name} {camera.serial}".strip(),
            f"Image circle {found}; field of view taken as {choice.field_degrees:g} degrees.",
        )
        return PlannedCamera(
            camera_id=choice.camera_id,
            lens=lens,
            source=source_values(camera, pixel_format, choice.exposure_s),
            remarks=remarks,
        )

    def write(
        self,
        choices: Sequence[CameraChoice],
        *,
        name: str = "",
        model: Path | None = None,
        frame_rate: float = 10.0,
        overwrite: bool = False,
    ) -> RoomConfig:
        """Write the room file, or add to the one that is there.

        Args:
            choices: the cameras.
            name: of a new room.
            model: GLB of a new room.
            frame_rate: of a new room.
            overwrite: replace a file that is there instead of adding to it.

        Returns:
            The room as it loads.

        Raises:
            ConfigError, AssetError: see `room_file`.
        """
        planned = self.plan(choices)
        if not planned:
            raise ConfigError("no camera is chosen; a room needs at least one")
        if self.room_path.exists() and not overwrite:
            return add_cameras(self.room_path, planned)
        if model is None:
            raise ConfigError("no model is chosen; a room needs the GLB of its surfaces")
        return create_room(
            self.room_path,
            planned,
            name=name or self.default_name,
            model=model,
            frame_rate=frame_rate,
            overwrite=overwrite,
        )

    def close(self) -> None:
        """Let all cameras go."""
        with self._lock:
            self._close_viewers()

    def _close_viewers(self) -> None:
        for viewer in self._viewers.values():
            viewer.close()
        self._viewers.clear()


def _format_of(camera: Connected, wanted: str | None) -> str:
    if wanted is not None:
        if wanted not in camera.pixel_formats:
            raise ConfigError(
                f"{camera.name}: expected one of its pixel formats ({', '.join(camera.pixel_formats)}), found {wanted!r}"
            )
        return wanted
    chosen = choose_pixel_format(camera.kind, camera.pixel_formats)
    if chosen is None:
        raise ConfigError(
            f"{camera.name}: none of its pixel formats can be read ({', '.join(camera.pixel_formats) or 'it tells none'})"
        )
    return chosen
