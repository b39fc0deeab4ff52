"""Write everything that follows from schema.json: layout.py, layout.gen.ts and the byte tables of SPEC.md.

python protocol/generate.py           write
python protocol/generate.py --check   fail (exit 1) if a file is missing or out of date
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
PYTHON_FILE = FOLDER / "nearfield_protocol" / "layout.py"
TYPESCRIPT_FILE = FOLDER.parent / "client_web" / "src" / "protocol" / "layout.gen.ts"
SPEC_FILE = FOLDER / "SPEC.md"
BEGIN, END = "<!-- begin generated tables -->\n", "<!-- end generated tables -->\n"

SIZES = {"u1": 1, "u2": 2, "u4": 4, "u8": 8, "i2": 2, "f2": 2, "f4": 4}
NAMES = {
    "u1": "uint8", "u2": "uint16", "u4": "uint32", "u8": "uint64",
    "i2": "int16", "f2": "float16", "f4": "float32",
}  # fmt: skip
# A half float is its bits in TypeScript: DataView.getFloat16 is too young for tablets.
GETTERS = {
    "u1": "Uint8", "u2": "Uint16", "u4": "Uint32", "u8": "BigUint64",
    "i2": "Int16", "f2": "Uint16", "f4": "Float32",
}  # fmt: skip


@dataclass(frozen=True)
class Field:
    """One field with its place in the record."""

    name: str
    type: str
    count: int
    unit: str
    doc: str
    offset: int

    @property
    def size(self) -> int:
        """Bytes."""
        return SIZES[self.type] * self.count


@dataclass(frozen=True)
class Record:
    """One record: fields without gaps."""

    name: str
    doc: str
    fields: tuple[Field, ...]

    @property
    def size(self) -> int:
        """Bytes."""
        return sum(field.size for field in self.fields)


def parse_records(schema: dict[str, Any]) -> tuple[Record, ...]:
    """Lay the fields out one after the other.

    Raises:
        ValueError: A field is not aligned to min(its size, 4) bytes, so that typed-array views would need a copy.
    """
    records = []
    for entry in schema["records"]:
        offset, fields = 0, []
        for raw in entry["fields"]:
            field = Field(raw["name"], raw["type"], raw.get("count", 1), raw["unit"], raw["doc"], offset)
            if offset % min(SIZES[field.type], 4):
                raise ValueError(f"schema.json: {entry['name']}.{field.name} at byte {offset} is not aligned")
            offset += field.size
            fields.append(field)
        records.append(Record(entry["name"], entry["doc"], tuple(fields)))
    return tuple(records)


def python_source(schema: dict[str, Any], records: tuple[Record, ...]) -> str:
    """Source of nearfield_protocol/layout.py."""

    def lines() -> Iterator[str]:
        yield '"""Records on the wire as numpy dtypes. Generated from protocol/schema.json by generate.py: do not edit."""\n'
        yield "from __future__ import annotations\n"
        yield "from enum import IntEnum\nfrom typing import Any, Final\n"
        yield "import numpy as np\n"
        magic = int.from_bytes(schema["magic"].encode(), "little")
        yield f"MAGIC: Final = 0x{magic:08X}"
        yield f"VERSION: Final = {schema['version']}"
        yield f'SUBPROTOCOL: Final = "{schema["subprotocol"]}"'
        for name, limit in schema["limits"].items():
            yield f'{name}: Final = {limit["value"]}\n"""{limit["doc"]}"""'
        for enum in schema["enums"]:
            yield f'\n\nclass {enum["name"]}(IntEnum):\n    """{enum["doc"]}"""\n'
            for value in enum["values"]:
                yield f'    {value["name"]} = {value["value"]}\n    """{value["doc"]}"""'
        yield "\n\ndef _record(size: int, fields: list[tuple[str, str | tuple[str, int], int]]) -> np.dtype[Any]:"
        yield "    names, formats, offsets = zip(*fields, strict=True)"
        yield "    return np.dtype("
        yield '        {"names": names, "formats": formats, "offsets": offsets, "itemsize": size},'
        yield "    )\n\n"
        for record in records:
            yield f"{record.name.upper()} = _record(\n    {record.size},\n    ["
            for field in record.fields:
                form = f'"<{field.type}"' if field.count == 1 else f'("<{field.type}", {field.count})'
                yield f'        ("{field.name}", {form}, {field.offset}),'
            yield f'    ],\n)\n"""{record.doc}"""'

    return "\n".join(lines()) + "\n"


def typescript_source(schema: dict[str, Any], records: tuple[Record, ...]) -> str:
    """Source of client_web/src/protocol/layout.gen.ts."""

    def lines() -> Iterator[str]:
        yield "// Records on the wire. Generated from protocol/schema.json by generate.py: do not edit.\n"
        magic = int.from_bytes(schema["magic"].encode(), "little")
        yield f"export const MAGIC = 0x{magic:08x}"
        yield f"export const VERSION = {schema['version']}"
        yield f"export const SUBPROTOCOL = '{schema['subprotocol']}'"
        for name, limit in schema["limits"].items():
            yield f"/** {limit['doc']} */\nexport const {name} = {limit['value']}"
        for enum in schema["enums"]:
            yield f"\n/** {enum['doc']} */\nexport const {enum['name']} = {{"
            for value in enum["values"]:
                yield f"  /** {value['doc']} */\n  {value['name']}: {value['value']},"
            yield f"}} as const\nexport type {enum['name']} = (typeof {enum['name']})[keyof typeof {enum['name']}]"
        for record in records:
            yield from _typescript_record(record)

    return "\n".join(lines()) + "\n"


def _typescript_record(record: Record) -> Iterator[str]:
    camel = "".join(word.capitalize() for word in record.name.split("_"))
    upper = record.name.upper()
    yield f"\n/** {record.doc} */\nexport interface {camel}Record {{"
    for field in record.fields:
        number = "bigint" if field.type == "u8" else "number"
        form = number if field.count == 1 else f"ArrayLike<{number}>"
        shape = NAMES[field.type] + (f"[{field.count}]" if field.count > 1 else "")
        unit = f", {field.unit}" if field.unit else ""
        yield f"  /** {shape}{unit}: {field.doc} */\n  {field.name}: {form}"
    yield "}"
    yield f"export const {upper}_BYTES = {record.size}"
    yield f"export const {upper}_OFFSETS = {{"
    for field in record.fields:
        yield f"  {field.name}: {field.offset},"
    yield "} as const"
    yield f"export function read{camel}(view: DataView, offset: number): {camel}Record {{\n  return {{"
    for field in record.fields:
        yield f"    {field.name}: {_typescript_read(field)},"
    yield "  }\n}"
    yield f"export function write{camel}(view: DataView, offset: number, record: {camel}Record): void {{"
    for field in record.fields:
        step = SIZES[field.type]
        for i in range(field.count):
            value = f"record.{field.name}" + (f"[{i}]" if field.count > 1 else "")
            value += " as number" if field.count > 1 else ""
            little = "" if step == 1 else ", true"
            yield f"  view.set{GETTERS[field.type]}(offset + {field.offset + i * step}, {value}{little})"
    yield "}"


def _typescript_read(field: Field) -> str:
    step = SIZES[field.type]
    little = "" if step == 1 else ", true"
    reads = [
        f"view.get{GETTERS[field.type]}(offset + {field.offset + i * step}{little})"
        for i in range(field.count)
    ]
    return reads[0] if field.count == 1 else "[" + ", ".join(reads) + "]"


def spec_tables(schema: dict[str, Any], records: tuple[Record, ...]) -> str:
    """Markdown byte tables and enumerations for SPEC.md."""

    def lines() -> Iterator[str]:
        for record in records:
            yield f"\n### `{record.name}` ({record.size} bytes)\n\n{record.doc}\n"
            yield "| Bytes | Name | Type | Unit | Description |\n|---|---|---|---|---|"
            for field in record.fields:
                shape = NAMES[field.type] + (f"[{field.count}]" if field.count > 1 else "")
                last = field.offset + field.size - 1
                span = f"{field.offset}" if field.size == 1 else f"{field.offset}..{last}"
                yield f"| {span} | `{field.name}` | {shape} | {field.unit} | {field.doc} |"
        for enum in schema["enums"]:
            yield f"\n### {enum['name']}\n\n{enum['doc']}\n\n| Value | Name | Meaning |\n|---|---|---|"
            for value in enum["values"]:
                yield f"| {value['value']} | `{value['name']}` | {value['doc']} |"
        yield "\n### Limits and constants\n\n| Name | Value | Meaning |\n|---|---|---|"
        for name, limit in schema["limits"].items():
            yield f"| `{name}` | {limit['value']} | {limit['doc']} |"

    return "\n".join(lines()).lstrip("\n") + "\n"


def outputs() -> dict[Path, str]:
    """Every generated file with the text that it should hold."""
    schema = json.loads((FOLDER / "schema.json").read_text(encoding="utf-8"))
    records = parse_records(schema)
    spec = SPEC_FILE.read_text(encoding="utf-8")
    before, rest = spec.split(BEGIN)
    after = rest.split(END)[1]
    return {
        PYTHON_FILE: python_source(schema, records),
        TYPESCRIPT_FILE: typescript_source(schema, records),
        SPEC_FILE: before + BEGIN + "\n" + spec_tables(schema, records) + "\n" + END + after,
    }


def main(arguments: list[str]) -> int:
    """Entry point."""
    stale = []
    for path, text in outputs().items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            stale.append(path)
            if "--check" not in arguments:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
    for path in stale:
        sys.stdout.write(
            f"{'out of date' if '--check' in arguments else 'written'}: {path.relative_to(FOLDER.parent)}\n"
        )
    return 1 if stale and "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
