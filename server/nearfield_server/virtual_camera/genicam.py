"""The description that a simulated camera gives of itself: GenICam XML, and the registers behind it.

Names follow the GenICam Standard Features Naming Convention. Registers below 0x400 are those of libaravis's
device class; those from 0x400 are ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Final
from xml.etree import ElementTree

from nearfield_server.virtual_camera.formats import SentFormat

_NAMESPACE: Final = "http://www.genicam.org/GenApi/Version_1_0"
EXPOSURE_RANGE_US: Final = (1.0, 10_000_000.0)
GAIN_RANGE_DB: Final = (0.0, 48.0)
FRAME_RATE_RANGE: Final = (0.1, 1000.0)
DEVICE_CLOCK_HZ: Final = 1_000_000_000


class Register(IntEnum):
    """Addresses of registers."""

    VENDOR_NAME = 0x48
    MODEL_NAME = 0x68
    DEVICE_VERSION = 0x88
    SERIAL_NUMBER = 0xD8
    WIDTH = 0x100
    HEIGHT = 0x104
    BINNING_HORIZONTAL = 0x108
    BINNING_VERTICAL = 0x10C
    SENSOR_HEIGHT = 0x118
    SENSOR_WIDTH = 0x11C
    ACQUISITION = 0x124
    PIXEL_FORMAT = 0x128
    ACQUISITION_MODE = 0x12C
    OFFSET_X = 0x130
    OFFSET_Y = 0x134
    FRAME_PERIOD_US = 0x138
    TRIGGER_MODE = 0x300
    TRIGGER_SOURCE = 0x304
    TRIGGER_ACTIVATION = 0x308
    TRIGGER_SOFTWARE = 0x30C
    EXPOSURE_US = 0x400
    GAIN_DB = 0x408
    BLACK_LEVEL = 0x410
    TEMPERATURE = 0x418
    PTP_ENABLE = 0x420
    PTP_STATUS = 0x424
    PTP_OFFSET_NS = 0x428
    TEST_PATTERN = 0x430
    EXPOSURE_AUTO = 0x434
    GAIN_AUTO = 0x438
    CLOCK_HZ_HIGH = 0x93C
    STREAM_PORT = 0xD00
    STREAM_ADDRESS = 0xD18


FLOAT_FEATURES: Final[Mapping[str, Register]] = {
    "ExposureTime": Register.EXPOSURE_US,
    "Gain": Register.GAIN_DB,
    "BlackLevel": Register.BLACK_LEVEL,
    "DeviceTemperature": Register.TEMPERATURE,
}
"""Features that are a big-endian double in a register."""

PTP_DISABLED: Final = 2
PTP_SLAVE: Final = 8
PATTERN_OFF: Final = 0
PATTERN_RAMP: Final = 1
_OFF_ON: Final = {"Off": 0, "On": 1}
_PTP_STATES: Final = (
    "Initializing",
    "Faulty",
    "Disabled",
    "Listening",
    "PreMaster",
    "Master",
    "Passive",
    "Uncalibrated",
    "Slave",
)


class _Description:
    """Collects nodes and the categories that list them."""

    def __init__(self) -> None:
        self.root = ElementTree.Element(
            "RegisterDescription",
            {
                "xmlns": _NAMESPACE,
                "ModelName": "TestCamera",
                "VendorName": "Nearfield",
                "ToolTip": "A simulated camera that looks at a room",
                "StandardNameSpace": "GEV",
                **{
                    f"Schema{part}Version": value
                    for part, value in (("Major", "1"), ("Minor", "1"), ("SubMinor", "0"))
                },
                **{
                    f"{part}Version": value
                    for part, value in (("Major", "1"), ("Minor", "0"), ("SubMinor", "0"))
                },
                "ProductGuid": "3F0C5A52-66F1-4A8B-9B0E-4D2C6F1B7A10",
                "VersionGuid": "9A4E8C11-2D57-4C3F-8E66-0B1F5D7C2E91",
            },
        )

    def node(self, kind: str, name: str, *children: tuple[str, object]) -> ElementTree.Element:
        node = ElementTree.SubElement(self.root, kind, {"Name": name})
        for tag, value in children:
            ElementTree.SubElement(node, tag).text = str(value)
        return node

    def category(self, name: str, features: Iterable[str]) -> None:
        self.node("Category", name, *(("pFeature", feature) for feature in features))

    def register(
        self, kind: str, name: str, address: int, length: int, access: str, *children: tuple[str, object]
    ) -> None:
        self.node(
            kind,
            name,
            *(("Address", hex(address)), ("Length", length), ("AccessMode", access), ("pPort", "Device")),
            *children,
        )

    def text(self, name: str, address: int, length: int) -> None:
        self.register("StringReg", name, address, length, "RO")

    def integer(
        self,
        name: str,
        address: int,
        *limits: tuple[str, object],
        access: str = "RW",
        length: int = 4,
        sign: str = "Unsigned",
    ) -> None:
        self.node("Integer", name, ("pValue", f"{name}Reg"), *limits)
        self.register(
            "IntReg", f"{name}Reg", address, length, access, ("Sign", sign), ("Endianess", "BigEndian")
        )

    def real(
        self, name: str, address: int, limits: tuple[float, float], unit: str, access: str = "RW"
    ) -> None:
        self.node(
            "Float", name, ("pValue", f"{name}Reg"), ("Min", limits[0]), ("Max", limits[1]), ("Unit", unit)
        )
        self.register("FloatReg", f"{name}Reg", address, 8, access, ("Endianess", "BigEndian"))

    def choice(self, name: str, address: int, entries: Mapping[str, int], access: str = "RW") -> None:
        enumeration = self.node("Enumeration", name)
        for entry, value in entries.items():
            node = ElementTree.SubElement(enumeration, "EnumEntry", {"Name": entry})
            ElementTree.SubElement(node, "Value").text = str(value)
        ElementTree.SubElement(enumeration, "pValue").text = f"{name}Reg"
        self.register(
            "IntReg", f"{name}Reg", address, 4, access, ("Sign", "Unsigned"), ("Endianess", "BigEndian")
        )

    def command(self, name: str, register: str, value: int) -> None:
        self.node("Command", name, ("pValue", register), ("CommandValue", value))

    def command_register(self, name: str, address: int) -> None:
        self.register("IntReg", name, address, 4, "WO", ("Sign", "Unsigned"), ("Endianess", "BigEndian"))


def describe_camera(formats: Iterable[SentFormat], top_code: int) -> str:
    """Write the XML.

    Args:
        formats: what `PixelFormat` offers.
        top_code: greatest code of any of them; the black level is at most half of it.
    """
    made = _Description()
    made.category(
        "Root",
        (
            "DeviceControl",
            "ImageFormatControl",
            "AcquisitionControl",
            "AnalogControl",
            "PtpControl",
            "TransportLayerControl",
        ),
    )
    _add_device(made)
    _add_image_format(made, formats)
    _add_acquisition(made)
    _add_analog(made, top_code)
    _add_ptp(made)
    made.category("TransportLayerControl", ("PayloadSize", "GevTimestampTickFrequency"))
    payload = made.node("IntSwissKnife", "PayloadSize")
    for variable, feature in (("WIDTH", "Width"), ("HEIGHT", "Height"), ("FORMAT", "PixelFormat")):
        ElementTree.SubElement(payload, "pVariable", {"Name": variable}).text = feature
    ElementTree.SubElement(payload, "Formula").text = "WIDTH * HEIGHT * ((FORMAT >> 16) & 255) / 8"
    made.integer("GevTimestampTickFrequency", Register.CLOCK_HZ_HIGH, access="RO", length=8)
    made.node("Port", "Device")
    return ElementTree.tostring(made.root, encoding="unicode", xml_declaration=True)


def _add_device(made: _Description) -> None:
    made.category(
        "DeviceControl",
        ("DeviceVendorName", "DeviceModelName", "DeviceVersion", "DeviceSerialNumber", "DeviceTemperature"),
    )
    made.text("DeviceVendorName", Register.VENDOR_NAME, 32)
    made.text("DeviceModelName", Register.MODEL_NAME, 32)
    made.text("DeviceVersion", Register.DEVICE_VERSION, 32)
    made.text("DeviceSerialNumber", Register.SERIAL_NUMBER, 16)
    made.real("DeviceTemperature", Register.TEMPERATURE, (-273.15, 200.0), "C", access="RO")


def _add_image_format(made: _Description, formats: Iterable[SentFormat]) -> None:
    made.category(
        "ImageFormatControl",
        (
            "SensorWidth",
            "SensorHeight",
            "OffsetX",
            "OffsetY",
            "Width",
            "Height",
            "PixelFormat",
            "TestPattern",
        ),
    )
    made.integer("SensorWidth", Register.SENSOR_WIDTH, access="RO")
    made.integer("SensorHeight", Register.SENSOR_HEIGHT, access="RO")
    made.integer("OffsetX", Register.OFFSET_X, ("Min", 0), ("pMax", "SensorWidth"), ("Inc", 2))
    made.integer("OffsetY", Register.OFFSET_Y, ("Min", 0), ("pMax", "SensorHeight"), ("Inc", 2))
    made.integer("Width", Register.WIDTH, ("Min", 16), ("pMax", "SensorWidth"), ("Inc", 2))
    made.integer("Height", Register.HEIGHT, ("Min", 2), ("pMax", "SensorHeight"), ("Inc", 2))
    made.choice("PixelFormat", Register.PIXEL_FORMAT, {each.name: each.number for each in formats})
    made.choice("TestPattern", Register.TEST_PATTERN, {"Off": PATTERN_OFF, "GreyDiagonalRamp": PATTERN_RAMP})


def _add_acquisition(made: _Description) -> None:
    made.category(
        "AcquisitionControl",
        (
            *("AcquisitionMode", "AcquisitionStart", "AcquisitionStop", "AcquisitionFrameRate"),
            *("TriggerSelector", "TriggerMode", "TriggerSource", "TriggerActivation", "TriggerSoftware"),
            *("ExposureTime", "ExposureAuto"),
        ),
    )
    made.choice(
        "AcquisitionMode", Register.ACQUISITION_MODE, {"Continuous": 1, "SingleFrame": 2, "MultiFrame": 3}
    )
    made.command("AcquisitionStart", "AcquisitionReg", 1)
    made.command("AcquisitionStop", "AcquisitionReg", 0)
    made.command_register("AcquisitionReg", Register.ACQUISITION)
    made.node(
        "Float",
        "AcquisitionFrameRate",
        ("pValue", "FrameRateOfPeriod"),
        ("Min", FRAME_RATE_RANGE[0]),
        ("Max", FRAME_RATE_RANGE[1]),
        ("Unit", "Hz"),
    )
    made.node(
        "Converter",
        "FrameRateOfPeriod",
        ("FormulaTo", "1000000 / FROM"),
        ("FormulaFrom", "1000000 / TO"),
        ("pValue", "FramePeriod"),
    )
    made.integer("FramePeriod", Register.FRAME_PERIOD_US, ("Min", 1000), ("Max", 10_000_000))
    made.node("Enumeration", "TriggerSelector").append(_entry("FrameStart", 0))
    ElementTree.SubElement(made.root[-1], "pValue").text = "TriggerSelectorValue"
    made.node("Integer", "TriggerSelectorValue", ("Value", 0))
    made.choice("TriggerMode", Register.TRIGGER_MODE, _OFF_ON)
    made.choice("TriggerSource", Register.TRIGGER_SOURCE, {"Line0": 0, "Software": 1})
    made.choice("TriggerActivation", Register.TRIGGER_ACTIVATION, {"RisingEdge": 0})
    made.command("TriggerSoftware", "TriggerSoftwareReg", 1)
    made.command_register("TriggerSoftwareReg", Register.TRIGGER_SOFTWARE)
    made.real("ExposureTime", Register.EXPOSURE_US, EXPOSURE_RANGE_US, "us")
    made.choice("ExposureAuto", Register.EXPOSURE_AUTO, {"Off": 0})


def _add_analog(made: _Description, top_code: int) -> None:
    made.category("AnalogControl", ("Gain", "GainAuto", "BlackLevel"))
    made.real("Gain", Register.GAIN_DB, GAIN_RANGE_DB, "dB")
    made.choice("GainAuto", Register.GAIN_AUTO, {"Off": 0})
    made.real("BlackLevel", Register.BLACK_LEVEL, (0.0, 0.5 * top_code), "DN")


def _add_ptp(made: _Description) -> None:
    made.category("PtpControl", ("PtpEnable", "PtpStatus", "PtpOffsetFromMaster"))
    made.node("Boolean", "PtpEnable", ("pValue", "PtpEnableReg"), ("OnValue", 1), ("OffValue", 0))
    made.register(
        "IntReg",
        "PtpEnableReg",
        Register.PTP_ENABLE,
        4,
        "RW",
        ("Sign", "Unsigned"),
        ("Endianess", "BigEndian"),
    )
    made.choice(
        "PtpStatus", Register.PTP_STATUS, {name: value for value, name in enumerate(_PTP_STATES)}, access="RO"
    )
    made.integer("PtpOffsetFromMaster", Register.PTP_OFFSET_NS, access="RO", length=8, sign="Signed")


def _entry(name: str, value: int) -> ElementTree.Element:
    entry = ElementTree.Element("EnumEntry", {"Name": name})
    ElementTree.SubElement(entry, "Value").text = str(value)
    return entry
