"""Bytes of the light packet: virtual area lights and the SH of every object (Rohmer et al. 2014, Section 5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol import quantise
from nearfield_protocol.framing import HEADER_BYTES, Reader, check_limit, frame, require, write_record
from nearfield_protocol.layout import (
    LIGHT_PACKET,
    MAX_OBJECTS,
    MAX_SECTIONS,
    MAX_VALS,
    OBJECT_SH_COMPACT,
    OBJECT_SH_PLAIN,
    OBJECT_STATE,
    SECTION_ENTRY,
    VAL_COMPACT,
    VAL_PLAIN,
    Encoding,
    MessageType,
    SectionKind,
)
from nearfield_protocol.light_records import (
    MAX_COORDINATE,
    VAL_DTYPE,
    LightPacket,
    checked_bounds,
    checked_objects,
    checked_unsigned,
    checked_vals,
    empty_vals,
)

ELEMENTS = {
    Encoding.PLAIN: {
        SectionKind.VALS: VAL_PLAIN,
        SectionKind.OBJECT_SH: OBJECT_SH_PLAIN,
        SectionKind.OBJECT_STATES: OBJECT_STATE,
    },
    Encoding.COMPACT: {
        SectionKind.VALS: VAL_COMPACT,
        SectionKind.OBJECT_SH: OBJECT_SH_COMPACT,
        SectionKind.OBJECT_STATES: OBJECT_STATE,
    },
}
LIMITS = {
    SectionKind.VALS: MAX_VALS,
    SectionKind.OBJECT_SH: MAX_OBJECTS,
    SectionKind.OBJECT_STATES: MAX_OBJECTS,
}


def encode_light_packet(packet: LightPacket, encoding: Encoding = Encoding.COMPACT) -> bytes:
    """Write a light packet.

    Raises:
        EncodeError: A number cannot be written: non-finite or negative radiant intensity, a position outside the bounds, a normal that
            is not a unit vector, ... The error names the VAL or object.
    """
    bounds_min, bounds_size = checked_bounds(packet)
    vals = checked_vals(packet.vals, bounds_min, bounds_size)
    object_sh, revisions = checked_objects(packet)
    if encoding is Encoding.COMPACT:
        val_exponent = quantise.rgb9e5_scale_exponent(vals["radiant_intensity"])
        sh_exponent = quantise.half_scale_exponent(object_sh)
        val_part = _compact_vals(vals, bounds_min, bounds_size, val_exponent)
        sh_part = quantise.encode_halves(object_sh, sh_exponent).astype("<f2").tobytes()
    else:
        val_exponent = sh_exponent = 0
        val_part = _plain_vals(vals)
        sh_part = object_sh.astype("<f4").tobytes()
    sections = [
        (SectionKind.VALS, len(vals), val_exponent, val_part),
        (SectionKind.OBJECT_SH, len(object_sh), sh_exponent, sh_part),
        (SectionKind.OBJECT_STATES, len(revisions), 0, revisions.astype("<u4").tobytes()),
    ]
    table = b"".join(
        write_record(
            SECTION_ENTRY,
            kind=kind,
            num_elements=count,
            stride=ELEMENTS[encoding][kind].itemsize,
            scale_exponent=exponent,
        )
        for kind, count, exponent, _ in sections
    )
    head = write_record(
        LIGHT_PACKET,
        timestamp_ns=checked_unsigned("timestamp_ns", packet.timestamp_ns, 64),
        room_revision=checked_unsigned("room_revision", packet.room_revision, 32),
        encoding=encoding,
        num_sections=len(sections),
        bounds_min=bounds_min,
        bounds_size=bounds_size,
    )
    body = [part + bytes(-len(part) % 4) for _, _, _, part in sections]
    return frame(MessageType.LIGHT_PACKET, packet.sequence, head, table, *body)


def decode_light_packet(data: bytes) -> LightPacket:
    """Read a light packet of either encoding.

    Raises:
        DecodeError: The bytes are not a valid light packet; says where, what was expected and what was found.
    """
    reader = Reader(data)
    reader.expect(MessageType.LIGHT_PACKET)
    start = reader.offset
    head = reader.record(LIGHT_PACKET, "light_packet")
    require(
        head["encoding"] in (0, 1),
        "encoding",
        offset=start + 12,
        expected="0 (plain) or 1 (compact)",
        found=int(head["encoding"]),
    )
    encoding = Encoding(int(head["encoding"]))
    bounds_min, bounds_size = head["bounds_min"].astype(np.float32), head["bounds_size"].astype(np.float32)
    require(
        bool(np.isfinite(bounds_min).all()),
        "bounds_min",
        offset=start + 16,
        expected="finite numbers",
        found=bounds_min,
    )
    require(
        bool(((bounds_size > 0) & (bounds_size <= MAX_COORDINATE)).all()),
        "bounds_size",
        offset=start + 28,
        expected=f"> 0, at most {MAX_COORDINATE:g} m",
        found=bounds_size,
    )
    sections = _read_sections(reader, int(head["num_sections"]), encoding)
    vals = _read_vals(sections, encoding, bounds_min, bounds_size)
    object_sh = _read_object_sh(sections, encoding)
    revisions = sections[SectionKind.OBJECT_STATES].elements["pose_revision"].astype(np.uint32)
    if len(revisions) != len(object_sh):
        raise_at = sections[SectionKind.OBJECT_STATES].offset
        require(
            False,
            "object_states",
            offset=raise_at,
            expected=f"{len(object_sh)} entries, one per object",
            found=len(revisions),
        )
    return LightPacket(
        sequence=reader.header.sequence,
        timestamp_ns=int(head["timestamp_ns"]),
        room_revision=int(head["room_revision"]),
        vals=vals,
        object_sh=object_sh,
        object_revisions=revisions,
        bounds_min=bounds_min,
        bounds_size=bounds_size,
    )


@dataclass(frozen=True, slots=True)
class _Section:
    elements: NDArray[Any]
    scale_exponent: int
    offset: int


def _read_sections(reader: Reader, count: int, encoding: Encoding) -> dict[SectionKind, _Section]:
    table_offset = reader.offset
    check_limit("num_sections", count, MAX_SECTIONS, HEADER_BYTES + 13)
    table = reader.array(SECTION_ENTRY, count, "section_table")
    sections: dict[SectionKind, _Section] = {}
    for i, entry in enumerate(table):
        kind, num, stride, at = (
            int(entry["kind"]),
            int(entry["num_elements"]),
            int(entry["stride"]),
            table_offset + 8 * i,
        )
        start = reader.offset
        if kind not in ELEMENTS[encoding]:
            # A section that this version does not know adds to the packet and changes nothing else: skip it.
            reader.array("u1", num * stride, f"section {kind}")
        else:
            known = SectionKind(kind)
            dtype = ELEMENTS[encoding][known]
            require(
                known not in sections,
                f"section_table[{i}].kind",
                offset=at,
                expected="each kind once",
                found=known.name,
            )
            check_limit(f"section_table[{i}].num_elements", num, LIMITS[known], at + 2)
            require(
                stride == dtype.itemsize,
                f"section_table[{i}].stride",
                offset=at + 4,
                expected=dtype.itemsize,
                found=stride,
            )
            elements = reader.array(dtype, num, known.name.lower())
            sections[known] = _Section(
                elements, _checked_exponent(int(entry["scale_exponent"]), known, encoding, at + 6), start
            )
        reader.padding()
    reader.end()
    for kind in ELEMENTS[encoding]:
        require(
            kind in sections,
            "section_table",
            offset=table_offset,
            expected=f"a section {kind.name}",
            found="none",
        )
    return sections


def _checked_exponent(exponent: int, kind: SectionKind, encoding: Encoding, offset: int) -> int:
    lowest, highest = 0, 0
    if encoding is Encoding.COMPACT and kind is SectionKind.VALS:
        lowest, highest = quantise.MIN_SCALE_EXPONENT_RGB, 127 - 16
    elif encoding is Encoding.COMPACT and kind is SectionKind.OBJECT_SH:
        lowest, highest = quantise.MIN_SCALE_EXPONENT_HALF, 127 - 15
    require(
        lowest <= exponent <= highest,
        "scale_exponent",
        offset=offset,
        expected=f"{lowest} to {highest}",
        found=exponent,
    )
    return exponent


def _read_vals(
    sections: dict[SectionKind, _Section],
    encoding: Encoding,
    bounds_min: NDArray[np.float32],
    bounds_size: NDArray[np.float32],
) -> NDArray[np.void]:
    section = sections[SectionKind.VALS]
    raw = section.elements
    bad = quantise.bad_normals(raw["normal"])
    _require_all(~bad, section, "vals", "normal", raw["normal"], "octahedral coordinates of at most 4094")
    vals = np.zeros(len(raw), VAL_DTYPE)
    vals["normal"], vals["generation"] = quantise.decode_normals(raw["normal"])
    if encoding is Encoding.COMPACT:
        vals["position"] = quantise.decode_positions(raw["position"], bounds_min, bounds_size)
        vals["radiant_intensity"] = quantise.decode_rgb9e5(raw["radiant_intensity"], section.scale_exponent)
        vals["area"] = quantise.decode_areas(raw["area"])
        return vals
    for name in ("position", "radiant_intensity", "area"):
        vals[name] = raw[name]
    intensity, area = vals["radiant_intensity"], vals["area"]
    _require_all(
        np.isfinite(vals["position"]).all(axis=1),
        section,
        "vals",
        "position",
        raw["position"],
        "finite numbers",
    )
    valid = ((intensity >= 0) & (intensity <= quantise.MAX_RADIOMETRIC)).all(axis=1)
    _require_all(valid, section, "vals", "radiant_intensity", raw["radiant_intensity"], "0 to 2^126")
    _require_all(
        (area >= 0) & (area <= quantise.AREA_MAX),
        section,
        "vals",
        "area",
        raw["area"],
        f"0 to {quantise.AREA_MAX:g}",
    )
    return vals


def _read_object_sh(sections: dict[SectionKind, _Section], encoding: Encoding) -> NDArray[np.float32]:
    section = sections[SectionKind.OBJECT_SH]
    raw = section.elements["sh_coeffs"]
    _require_all(np.isfinite(raw).all(axis=1), section, "object_sh", "sh_coeffs", raw, "finite numbers")
    if encoding is Encoding.COMPACT:
        coeffs = quantise.decode_halves(raw, section.scale_exponent)
    else:
        coeffs = raw.astype(np.float32)
        valid = (np.abs(coeffs) <= quantise.MAX_RADIOMETRIC).all(axis=1)
        _require_all(valid, section, "object_sh", "sh_coeffs", raw, "magnitudes of at most 2^126")
    return coeffs.reshape(-1, 9, 3)


def _require_all(
    valid: NDArray[np.bool_] | np.bool_,
    section: _Section,
    name: str,
    field: str,
    values: NDArray[Any],
    expected: object,
) -> None:
    if np.all(valid):
        return
    i = int(np.argmin(valid))
    dtype = section.elements.dtype
    fields = dtype.fields
    offset = section.offset + i * dtype.itemsize + (fields[field][1] if fields else 0)
    require(
        False, f"{name}[{i}].{field}", offset=offset, expected=expected, found=np.asarray(values[i]).tolist()
    )


def _compact_vals(
    vals: NDArray[np.void], bounds_min: NDArray[np.float32], bounds_size: NDArray[np.float32], exponent: int
) -> bytes:
    out = np.zeros(len(vals), VAL_COMPACT)
    out["position"] = quantise.encode_positions(vals["position"], bounds_min, bounds_size)
    out["area"] = quantise.encode_areas(vals["area"])
    out["normal"] = quantise.encode_normals(vals["normal"], vals["generation"])
    out["radiant_intensity"] = quantise.encode_rgb9e5(vals["radiant_intensity"], exponent)
    # Light that is too dim to be written leaves a slot without light, which has one way to be written.
    unused = out["radiant_intensity"] & 0x7FFFFFF == 0
    blank = empty_vals(1, bounds_min)
    out["position"][unused] = 0
    out["area"][unused] = 0
    out["radiant_intensity"][unused] = 0
    out["normal"][unused] = quantise.encode_normals(
        np.repeat(blank["normal"], int(unused.sum()), axis=0), vals["generation"][unused]
    )
    return out.tobytes()


def _plain_vals(vals: NDArray[np.void]) -> bytes:
    out = np.zeros(len(vals), VAL_PLAIN)
    for name in ("position", "radiant_intensity", "area"):
        out[name] = vals[name]
    out["normal"] = quantise.encode_normals(vals["normal"], vals["generation"])
    return out.tobytes()
