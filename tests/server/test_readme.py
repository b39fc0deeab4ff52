"""The documented keys of a room file are the keys that the code reads, with the same defaults."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from nearfield_server.scene import device_schema, room_schema
from nearfield_server.scene.node_config import NodeCameraTable, NodeTable

README = Path(__file__).parents[2] / "server" / "README.md"
TABLES: dict[str, type[BaseModel]] = {
    "": room_schema.RoomTable,
    "light.": room_schema.LightTable,
    "lights.": room_schema.SwitchableLightTable,
    "cameras.": room_schema.CameraTable,
    "objects.": room_schema.ObjectTable,
    "views.": room_schema.ViewTable,
    "remote.": room_schema.RemoteTable,
    "device.": device_schema.SensorTable,
    "aravis.": device_schema.AravisSourceTable,
    "v4l2.": device_schema.V4l2SourceTable,
}


def own_fields(table: type[BaseModel]) -> dict[str, FieldInfo]:
    """Fields of a table; those that all devices have are documented once."""
    shared = device_schema.SensorTable.model_fields if table is not device_schema.SensorTable else {}
    return {name: field for name, field in table.model_fields.items() if name not in shared}


def test_the_example_of_a_node_file_is_valid_and_names_every_key() -> None:
    examples = re.findall(
        r"^```toml\n(.*?)^```", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    (example,) = [text for text in examples if "\nnode = " in text]
    table = NodeTable.model_validate(tomllib.loads(example))
    assert table.model_fields_set == NodeTable.model_fields.keys() - {"lights"}
    assert table.cameras[0].model_fields_set == NodeCameraTable.model_fields.keys()


def documented_keys() -> dict[str, str]:
    """Key to the text of its default column."""
    rows = re.findall(
        r"^\| `([a-z0-9_.]+)` \|.*\| ([^|]+) \|$", README.read_text(encoding="utf-8"), re.MULTILINE
    )
    return {key: default.strip() for key, default in rows}


def test_every_key_is_documented_and_every_documented_key_exists() -> None:
    in_code = {
        f"{prefix}{name}"
        for prefix, table in TABLES.items()
        for name in own_fields(table)
        if f"{name}." not in TABLES
    }
    assert set(documented_keys()) == in_code


def test_documented_defaults_are_those_of_the_code() -> None:
    documented = documented_keys()
    for prefix, table in TABLES.items():
        for name, field in own_fields(table).items():
            text = documented.get(f"{prefix}{name}")
            if text is None:
                continue
            assert (text == "required") == field.is_required(), f"{prefix}{name}"
            if field.default is not PydanticUndefined and isinstance(field.default, int | float):
                assert float(text) == float(field.default), f"{prefix}{name}"
