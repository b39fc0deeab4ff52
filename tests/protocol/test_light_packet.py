"""Error bounds of the compact encoding over the whole range, refusals of the encoder, extension by unknown sections."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_protocol import codec, layout, quantise
from nearfield_protocol.errors import EncodeError, InvalidFieldError, UnsupportedVersionError
from nearfield_protocol.framing import write_record

F32 = np.float32
unit_interval = st.floats(0, 1)
log_radiance = st.floats(math.log2(1e-6 * 1e-6), math.log2(6e4 * 1e3))


@st.composite
def directions(draw: st.DrawFn) -> tuple[float, float, float]:
    z = draw(st.floats(-1, 1))
    phi = draw(st.floats(-math.pi, math.pi))
    r = math.sqrt(max(0.0, 1 - z * z))
    return (r * math.cos(phi), r * math.sin(phi), z)


@st.composite
def packets(draw: st.DrawFn) -> codec.LightPacket:
    low = np.array([draw(st.floats(-20, 20)) for _ in range(3)], F32)
    size = np.array([draw(st.floats(0.5, 50)) for _ in range(3)], F32)
    count = draw(st.integers(0, 6))
    vals = np.zeros(count, codec.VAL_DTYPE)
    for val in vals:
        fraction = np.array([draw(unit_interval) for _ in range(3)])
        val["position"] = np.clip(low.astype(float) + fraction * size, low, (low + size).astype(F32))
        val["normal"] = draw(directions())
        val["radiant_intensity"] = [2.0 ** draw(log_radiance) for _ in range(3)]
        val["area"] = 2.0 ** draw(st.floats(-38, 23))
        val["generation"] = draw(st.integers(0, 255))
    objects = draw(st.integers(0, 3))
    sh = np.array(
        [draw(st.floats(-1, 1)) * 2.0 ** draw(st.floats(-13, 14)) for _ in range(27 * objects)], F32
    )
    return codec.LightPacket(
        sequence=draw(st.integers(0, 2**32 - 1)),
        timestamp_ns=draw(st.integers(0, 2**64 - 1)),
        vals=vals,
        object_sh=sh.reshape(objects, 9, 3),
        object_revisions=np.arange(objects, dtype=np.uint32),
        bounds_min=low,
        bounds_size=size,
    )


def angle_degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    a, b = a.astype(np.float64), b.astype(np.float64)
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


@settings(max_examples=150, deadline=None)
@given(packets())
def test_compact_stays_within_the_stated_bounds(packet: codec.LightPacket) -> None:
    data = codec.encode_light_packet(packet)
    found = codec.decode_light_packet(data)
    assert codec.encode_light_packet(found) == data
    assert (found.sequence, found.timestamp_ns) == (packet.sequence, packet.timestamp_ns)
    before, after = packet.vals, found.vals
    error = np.abs(after["position"].astype(float) - before["position"])
    bound = packet.bounds_size / 131070 + 2.0**-24 * np.abs(after["position"]) * 1.0001
    # A light more than 2^40 below the brightest one of its packet cannot be written: its slot is empty.
    kept = after["radiant_intensity"].any(axis=1)
    intensity = before["radiant_intensity"].astype(float)
    brightest = intensity.max(initial=0)
    assert (intensity[~kept] <= brightest * 2.0**-40).all()
    assert (error <= bound)[kept].all()
    # 1e-5 degrees: decoded normals are float32.
    assert (angle_degrees(before["normal"], after["normal"])[kept] <= 0.0594 + 1e-5).all()
    error = np.abs(after["radiant_intensity"] - intensity)
    largest = intensity.max(axis=1, keepdims=True, initial=0)
    assert (error <= np.maximum(largest / 511.5, brightest * 2.0**-40)).all()
    area = before["area"].astype(float)
    assert (np.abs(after["area"] - area)[kept] <= area[kept] * 2.0**-11).all()
    np.testing.assert_array_equal(after["generation"], before["generation"])
    sh = packet.object_sh.astype(float)
    error = np.abs(found.object_sh - sh)
    per_object = np.abs(sh).max(axis=(1, 2), keepdims=True, initial=0)
    assert (error <= np.maximum(per_object * 2.0**-11, np.abs(sh).max(initial=0) * 2.0**-39)).all()


@settings(max_examples=50, deadline=None)
@given(packets())
def test_plain_changes_normals_only(packet: codec.LightPacket) -> None:
    data = codec.encode_light_packet(packet, codec.Encoding.PLAIN)
    found = codec.decode_light_packet(data)
    assert codec.encode_light_packet(found, codec.Encoding.PLAIN) == data
    for name in ("position", "radiant_intensity", "area", "generation"):
        np.testing.assert_array_equal(found.vals[name], packet.vals[name])
    np.testing.assert_array_equal(found.object_sh, packet.object_sh)
    assert (angle_degrees(packet.vals["normal"], found.vals["normal"]) <= 0.0594 + 1e-5).all()


@pytest.mark.parametrize("exponent", [-140, -60, 0, 60, 125])
def test_no_overflow_or_underflow_anywhere_in_float32(exponent: int) -> None:
    packet = one_val(radiant_intensity=(2.0**exponent, 2.0**exponent / 3, 0))
    found = codec.decode_light_packet(codec.encode_light_packet(packet)).vals["radiant_intensity"][0]
    expected = packet.vals["radiant_intensity"][0].astype(float)
    np.testing.assert_allclose(found, expected, rtol=0, atol=expected[0] / 511.5)


def test_normal_error_over_the_whole_sphere() -> None:
    i = np.arange(200_000) + 0.5
    z, phi = 1 - 2 * i / len(i), np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    normals = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
    words = quantise.encode_normals(normals, np.zeros(len(i), np.uint8))
    found, _ = quantise.decode_normals(words)
    assert angle_degrees(normals, found).max() <= math.degrees(math.sqrt(18) / 4094) + 1e-5
    np.testing.assert_array_equal(quantise.encode_normals(found, np.zeros(len(i), np.uint8)), words)


def test_axes_are_exact() -> None:
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    found, generations = quantise.decode_normals(quantise.encode_normals(axes, np.arange(6, dtype=np.uint8)))
    np.testing.assert_array_equal(found, axes)
    np.testing.assert_array_equal(generations, np.arange(6))


def test_every_area_code_and_half_float_survives() -> None:
    codes = np.arange(65536).astype(np.uint16)
    np.testing.assert_array_equal(quantise.encode_areas(quantise.decode_areas(codes)), codes)
    assert (np.diff(quantise.decode_areas(codes).astype(float)) > 0).all()


def test_rgb9e5_agrees_with_the_opengl_definition() -> None:
    """OpenGL 3.0, section 3.9.1: value = mantissa * 2^(exponent - 15 - 9); every canonical word survives."""
    rng = np.random.default_rng(2)
    mantissas = rng.integers(0, 512, (5000, 3))
    exponents = rng.integers(0, 32, 5000)
    words = (mantissas * (1, 512, 2**18)).sum(axis=1) + exponents * 2**27
    values = mantissas * 2.0 ** (exponents - 24.0)[:, None]
    np.testing.assert_array_equal(quantise.decode_rgb9e5(words.astype(np.uint32)), values)
    canonical = (mantissas.max(axis=1) >= 256) | (exponents == 0)
    np.testing.assert_array_equal(quantise.encode_rgb9e5(values[canonical]), words[canonical])


def one_val(**fields: object) -> codec.LightPacket:
    vals = np.zeros(3, codec.VAL_DTYPE)
    vals["normal"], vals["position"], vals["radiant_intensity"], vals["area"] = (0, 1, 0), 0.5, 1, 0.01
    for name, value in fields.items():
        vals[name][0] = value
    return codec.LightPacket(
        sequence=0,
        timestamp_ns=0,
        vals=vals[:1] if fields else vals,
        object_sh=np.zeros((1, 9, 3), F32),
        object_revisions=np.zeros(1, np.uint32),
        bounds_min=np.zeros(3, F32),
        bounds_size=np.ones(3, F32),
    )


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("position", (0.5, 1.01, 0.5)),
        ("position", (0.5, math.inf, 0.5)),
        ("position", (0.5, math.nan, 0.5)),
        ("radiant_intensity", (1, -1e-9, 1)),
        ("radiant_intensity", (1, math.nan, 1)),
        ("radiant_intensity", (math.inf, 1, 1)),
        ("normal", (0, 0, 0)),
        ("normal", (1, 1, 0)),
        ("area", -1.0),
        ("area", math.nan),
        ("area", 1e8),
    ],
)
@pytest.mark.parametrize("encoding", list(codec.Encoding))
def test_encoder_names_the_bad_val(field: str, value: object, encoding: codec.Encoding) -> None:
    packet = one_val()
    packet.vals[field][1] = value
    with pytest.raises(EncodeError, match=rf"^vals\[1\]\.{field}: expected .*, found"):
        codec.encode_light_packet(packet, encoding)


def test_encoder_names_the_bad_object() -> None:
    packet = one_val()
    packet.object_sh[0, 3, 1] = math.nan
    with pytest.raises(EncodeError, match=r"^object_sh\[0\]"):
        codec.encode_light_packet(packet)


def test_slots_without_light_may_hold_anything() -> None:
    packet = one_val(radiant_intensity=(0, 0, 0), position=(math.nan, 9, 9), normal=(0, 0, 0), generation=77)
    found = codec.decode_light_packet(codec.encode_light_packet(packet)).vals[0]
    assert found["generation"] == 77
    assert not found["radiant_intensity"].any()


def with_section(data: bytes, kind: int, stride: int, body: bytes) -> bytes:
    """The packet with one more section before the others."""
    head = bytearray(data[:56])
    head[16 + 13] += 1
    count = len(body) // stride
    entry = write_record(layout.SECTION_ENTRY, kind=kind, num_elements=count, stride=stride)
    result = bytes(head) + entry + data[56:80] + body + bytes(-len(body) % 4) + data[80:]
    return result[:12] + len(result).to_bytes(4, "little") + result[16:]


def test_unknown_sections_are_skipped() -> None:
    data = codec.encode_light_packet(one_val())
    longer = with_section(data, 900, 7, bytes(range(7)) * 5)
    assert codec.encode_light_packet(codec.decode_light_packet(longer)) == data


def test_repeated_and_missing_sections_are_refused() -> None:
    data = codec.encode_light_packet(one_val())
    with pytest.raises(InvalidFieldError, match="each kind once"):
        codec.decode_light_packet(with_section(data, 3, 4, bytes(4)))
    broken = bytearray(data)
    broken[56:58] = (900).to_bytes(2, "little")
    with pytest.raises(InvalidFieldError, match="a section VALS"):
        codec.decode_light_packet(bytes(broken))


def test_other_versions_are_refused() -> None:
    data = bytearray(codec.encode_light_packet(one_val()))
    data[4] = 2
    with pytest.raises(UnsupportedVersionError, match="version at byte 4: expected 1, found 2"):
        codec.decode_light_packet(bytes(data))
