"""The keys of a camera's `source` table when the camera is a real device (room.toml, format 1).

    [cameras.source]
    kind = "aravis"                         # GigE Vision and USB3 Vision
    address = "192.168.10.21"               # IPv4 address of a GigE camera; nothing is broadcast
    serial = "23104452"                     # or: serial number (USB3 Vision; a GigE camera needs `interface` too)
    interface = "enp3s0"                    # the one network interface on which a GigE camera is looked for by serial
    pixel_format = "BayerRG12p"             # name of the GenICam Pixel Format Naming Convention
    region = [0, 0, 1024, 1024]             # optional: x, y, width, height on the sensor, after binning
    binning = 1                             # optional
    trigger = "free"                        # "free" | "software" | "hardware" (hardware: line and edge by `features`)
    packet_size = 0                         # bytes; 0 = the largest that the way to the camera carries
    num_buffers = 4
    features = { Gamma = 1.0, ... }         # any GenICam feature, set in this order, before the stream starts and after every reconnect

    kind = "v4l2"
    path = "/dev/v4l/by-id/usb-..."         # stable name, survives replugging
    pixel_format = "SRGGB12"                # V4L2 four-character code or its usual name
    controls = { focus_auto = 0, ... }      # any V4L2 control by name, likewise
    exposure_unit_s = 1e-4                  # seconds of one unit of the exposure control, where V4L2 does not define it
    gain_steps = [[0, 0.0], [100, 24.0]]    # what the gain control means: its values and decibels, linear between

Both kinds, everything optional:

    exposure_s = 0.01                       # seconds
    gain_db = 0.0
    black_level = 0.0                       # codes that mean no light
    saturation = 0.98                       # share of the code range above which a code is no measurement
    radiance_per_code = 1.0                 # W/(sr m^2) of a code range filled in one second at 0 dB; 1 = relative radiance
    color_matrix = [[...], [...], [...]]    # linear camera RGB to linear sRGB, rows; absent = identity
    response = { kind = "linear" }
             | { kind = "table", codes = [...], signal = [...] }     # companded: linear between the points; top signal = 1
             | { kind = "knee", knees = [[code, worth], ...] }       # multi-slope: above a code (share of range) one code is worth so many
    hdr = { mode = "off" }
        | { mode = "bracket", exposures_s = [...] , method = "auto", settle_frames = 2 }
        | { mode = "bracket", num_exposures = 4, longest_s = 0.05, shortest_s = 0.00005 }   # chosen from the histogram
"""

from __future__ import annotations

from ipaddress import IPv4Address
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
_Text = Annotated[str, Field(min_length=1, max_length=256)]
FeatureValue = bool | int | Finite | Annotated[str, Field(max_length=1024)]
Row3 = tuple[Finite, Finite, Finite]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LinearResponseTable(_Strict):
    """Codes are proportional to light."""

    kind: Literal["linear"] = "linear"


class TableResponseTable(_Strict):
    """A companded sensor: `codes` (as the camera sends them) and the linear `signal` that each means, both ascending.

    The signal is relative to the full signal range of one exposure: the last entry is usually 1.
    """

    kind: Literal["table"]
    codes: Annotated[tuple[NotNegative, ...], Field(min_length=2, max_length=65536)]
    signal: Annotated[tuple[NotNegative, ...], Field(min_length=2, max_length=65536)]

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if len(self.codes) != len(self.signal):
            raise ValueError(
                f"expected as many codes as signals, found {len(self.codes)} and {len(self.signal)}"
            )
        for name in ("codes", "signal"):
            if np.any(np.diff(getattr(self, name)) <= 0):
                raise ValueError(f"expected ascending {name}")
        return self


class KneeResponseTable(_Strict):
    """A multi-slope sensor: above code share `knees[i][0]` one code is worth `knees[i][1]` codes of the first slope."""

    kind: Literal["knee"]
    knees: Annotated[
        tuple[tuple[Annotated[float, Field(gt=0, lt=1)], Annotated[float, Field(ge=1, le=1e6)]], ...],
        Field(min_length=1, max_length=8),
    ]

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        codes = [knee[0] for knee in self.knees]
        if sorted(set(codes)) != codes:
            raise ValueError(f"expected knees at ascending codes, found {codes}")
        return self


ResponseTable = Annotated[
    LinearResponseTable | TableResponseTable | KneeResponseTable, Field(discriminator="kind")
]


class NoHdrTable(_Strict):
    """One exposure per picture: the sensor delivers the whole range, or what it cannot hold is flagged."""

    mode: Literal["off"] = "off"


class BracketTable(_Strict):
    """Several exposures per picture: given, or chosen between two limits from the histogram."""

    mode: Literal["bracket"]
    exposures_s: Annotated[tuple[Positive, ...], Field(max_length=8)] = ()
    num_exposures: Annotated[int, Field(ge=2, le=8)] = 4
    longest_s: Positive | None = None
    shortest_s: Positive | None = None
    method: Literal["auto", "sequencer", "software_trigger", "free_running"] = "auto"
    settle_frames: Annotated[int, Field(ge=0, le=16)] | None = None

    @property
    def is_automatic(self) -> bool:
        """The exposures follow the scene."""
        return not self.exposures_s

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if len(self.exposures_s) == 1 or len(set(self.exposures_s)) != len(self.exposures_s):
            raise ValueError(f"expected two or more different exposures, found {self.exposures_s}")
        if self.longest_s and self.shortest_s and self.shortest_s >= self.longest_s:
            raise ValueError(f"expected shortest_s {self.shortest_s} below longest_s {self.longest_s}")
        return self


HdrTable = Annotated[NoHdrTable | BracketTable, Field(discriminator="mode")]


class SensorTable(_Strict):
    """What all devices have in common: exposure, and the way from codes to radiance."""

    exposure_s: Positive | None = None
    gain_db: Annotated[float, Field(ge=-60, le=60, allow_inf_nan=False)] = 0.0
    black_level: NotNegative = 0.0
    saturation: Annotated[float, Field(gt=0.5, le=1)] = 0.98
    radiance_per_code: Positive = 1.0
    color_matrix: tuple[Row3, Row3, Row3] | None = None
    response: ResponseTable = LinearResponseTable()
    hdr: HdrTable = NoHdrTable()


class AravisSourceTable(SensorTable):
    """A GigE Vision or USB3 Vision camera."""

    kind: Literal["aravis"]
    address: IPv4Address | None = None
    serial: _Text | None = None
    interface: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.:-]{0,14}$")] | None = None
    pixel_format: _Text = "BayerRG12p"
    region: (
        tuple[
            Annotated[int, Field(ge=0)],
            Annotated[int, Field(ge=0)],
            Annotated[int, Field(ge=1)],
            Annotated[int, Field(ge=1)],
        ]
        | None
    ) = None
    binning: Annotated[int, Field(ge=1, le=16)] = 1
    trigger: Literal["free", "software", "hardware"] = "free"
    packet_size: Annotated[int, Field(ge=0, le=65535)] = 0
    num_buffers: Annotated[int, Field(ge=2, le=64)] = 4
    features: dict[_Text, FeatureValue] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_way_to_find_it(self) -> Self:
        if (self.address is None) == (self.serial is None):
            raise ValueError("expected either address or serial")
        if self.interface is not None and self.serial is None:
            raise ValueError("interface only serves to find a camera by its serial; expected serial")
        return self


class V4l2SourceTable(SensorTable):
    """A camera of the Linux video system."""

    kind: Literal["v4l2"]
    path: Annotated[str, Field(pattern=r"^/dev/")]
    pixel_format: _Text = "YUYV"
    controls: dict[_Text, int | bool] = Field(default_factory=dict)
    exposure_unit_s: Positive | None = None
    gain_steps: Annotated[tuple[tuple[int, Finite], ...], Field(max_length=256)] = ()

    @model_validator(mode="after")
    def _ascending_gain(self) -> Self:
        if len(self.gain_steps) == 1:
            raise ValueError(
                "gain_steps: expected two or more pairs of control value and decibels, found one"
            )
        if self.gain_steps and np.any(np.diff(np.array(self.gain_steps), axis=0) <= 0):
            raise ValueError("gain_steps: expected ascending control values and decibels")
        return self


REMOTE_NAME: Final = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
"""What nodes and their cameras may be called: the names go into keys of the bus and names of files."""


class RemoteSourceTable(_Strict):
    """A camera of another machine, whose `nearfield capture` joins this service."""

    kind: Literal["remote"]
    node: Annotated[str, Field(pattern=REMOTE_NAME)]
    camera: Annotated[str, Field(pattern=REMOTE_NAME)]


DeviceSourceTable = AravisSourceTable | V4l2SourceTable
