"""The GLSL chunks that server and client share, run on a real GL (llvmpipe is enough) against float64."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from importlib.resources import files

import moderngl
import numpy as np
import pytest

from nearfield_protocol import quantise

pytestmark = pytest.mark.gl
CHUNKS = ("sh_basis", "octahedral", "val_irradiance")
Run = Callable[[str, np.ndarray, int], np.ndarray]


def chunk(name: str) -> str:
    return (files("nearfield_protocol") / "glsl" / f"{name}.glsl").read_text()


@pytest.fixture(scope="module")
def run() -> Iterator[Run]:
    """Evaluate `body` (it sets `result[0..3]` from `vec4 a`, `vec4 b`, ...) for every row of the input."""
    context = moderngl.create_standalone_context(backend="egl", require=330)
    # Without a window there is no default framebuffer, which drawing needs even if nothing is rasterised.
    context.simple_framebuffer((1, 1)).use()

    def evaluate(body: str, inputs: np.ndarray, num_results: int) -> np.ndarray:
        columns = inputs.shape[1] // 4
        names = "abcdef"[:columns]
        attributes = "".join(f"in vec4 {name};\n" for name in names)
        outputs = "".join(f"out float r{i};\n" for i in range(num_results))
        copies = "".join(f"r{i} = result[{i}];\n" for i in range(num_results))
        source = (
            "#version 330 core\n"
            + "".join(chunk(name) for name in CHUNKS)
            + f"{attributes}{outputs}void main() {{ float result[{num_results}];\n{body}\n{copies}}}"
        )
        program = context.program(vertex_shader=source, varyings=[f"r{i}" for i in range(num_results)])
        buffer = context.buffer(np.ascontiguousarray(inputs, np.float32).tobytes())
        layout = " ".join(["4f"] * columns)
        array = context.vertex_array(program, [(buffer, layout, *names)])
        target = context.buffer(reserve=4 * num_results * len(inputs))
        array.transform(target, moderngl.POINTS, len(inputs))
        assert context.error == "GL_NO_ERROR"
        return np.frombuffer(target.read(), np.float32).reshape(len(inputs), num_results).astype(np.float64)

    yield evaluate
    context.release()


@pytest.fixture
def directions() -> np.ndarray:
    rng = np.random.default_rng(3)
    found = rng.normal(size=(2000, 3))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    return np.concatenate([axes, found]).astype(np.float32)


def padded(*arrays: np.ndarray) -> np.ndarray:
    """Vectors of up to 4 numbers, each filled up to a vec4."""
    return np.concatenate([np.pad(array, ((0, 0), (0, 4 - array.shape[1]))) for array in arrays], axis=1)


def basis(d: np.ndarray) -> np.ndarray:
    x, y, z = d.astype(np.float64).T
    a, b, c = math.sqrt(1 / (4 * math.pi)), math.sqrt(3 / (4 * math.pi)), math.sqrt(15 / (4 * math.pi))
    e = math.sqrt(5 / (16 * math.pi))
    rows = [
        a + 0 * x,
        b * y,
        b * z,
        b * x,
        c * x * y,
        c * y * z,
        e * (3 * z * z - 1),
        c * x * z,
        c / 2 * (x * x - y * y),
    ]
    return np.stack(rows, axis=1)


def test_sh_basis(run: Run, directions: np.ndarray) -> None:
    found = run("shBasis(a.xyz, result);", padded(directions), 9)
    np.testing.assert_allclose(found, basis(directions), atol=3e-7)


def test_sh_irradiance_of_a_constant_and_a_linear_environment(run: Run, directions: np.ndarray) -> None:
    """Radiance 1 everywhere gives pi; radiance n0 . w gives 2 pi / 3 times n0 . n."""
    constant = (
        "vec3 c[9]; for (int k = 0; k < 9; ++k) c[k] = vec3(0.0); c[0] = vec3(3.5449077018110318 * a.w);"
    )
    ones = np.ones((len(directions), 1), np.float32)
    inputs = np.concatenate([directions, ones], axis=1)
    found = run(f"{constant} result[0] = shIrradiance(c, a.xyz).x;", inputs, 1)
    np.testing.assert_allclose(found[:, 0], math.pi, rtol=1e-6)
    linear = "vec3 c[9]; for (int k = 0; k < 9; ++k) c[k] = vec3(0.0); c[3] = vec3(2.046653415892977);"
    found = run(
        f"{linear} result[0] = shIrradiance(c, a.xyz).x; result[1] = shEvaluate(c, a.xyz).x;",
        padded(directions),
        2,
    )
    np.testing.assert_allclose(found[:, 0], 2 * math.pi / 3 * directions[:, 0], atol=1e-6)
    np.testing.assert_allclose(found[:, 1], directions[:, 0], atol=1e-6)


def test_octahedral_round_trip_and_wire_words(run: Run, directions: np.ndarray) -> None:
    body = "vec3 d = octahedralDecode(octahedralEncode(a.xyz)); result[0] = d.x; result[1] = d.y; result[2] = d.z;"
    np.testing.assert_allclose(run(body, padded(directions), 3), directions, atol=1e-6)
    words = quantise.encode_normals(directions, np.full(len(directions), 200, np.uint8))
    halves = np.stack([words & 0xFFFF, words >> 16], axis=1).astype(np.float32)
    body = (
        "vec3 d = octahedralDecodeWord(uint(a.x) | (uint(a.y) << 16)); "
        "result[0] = d.x; result[1] = d.y; result[2] = d.z;"
    )
    expected, _ = quantise.decode_normals(words)
    np.testing.assert_allclose(run(body, padded(halves), 3), expected, atol=1e-6)


def test_val_geometry_against_float64(run: Run) -> None:
    rng = np.random.default_rng(4)
    position, val_position = rng.uniform(-2, 2, (2, 1000, 3)).astype(np.float32)
    normal, val_normal = rng.normal(size=(2, 1000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    val_normal /= np.linalg.norm(val_normal, axis=1, keepdims=True)
    area = rng.uniform(0, 1, (1000, 1))
    body = "result[0] = valGeometry(a.xyz, b.xyz, c.xyz, d.xyz, a.w);"
    inputs = padded(np.concatenate([position, area], axis=1), normal, val_position, val_normal)
    to_val = val_position.astype(float) - position
    r = np.linalg.norm(to_val, axis=1)
    cosines = np.maximum((normal * to_val).sum(1) / r, 0) * np.maximum(-(val_normal * to_val).sum(1) / r, 0)
    expected = cosines / (r**2 + area[:, 0] / math.pi)
    np.testing.assert_allclose(run(body, inputs, 1)[:, 0], expected, rtol=1e-4, atol=1e-6)


def test_disc_term_is_exact_on_the_axis_and_finite_in_contact(run: Run) -> None:
    """A disc of radius R and radiance 1 gives pi R^2 / (r^2 + R^2) at distance r on its axis."""
    radius, distance = 0.3, np.array([0.0, 1e-6, 0.05, 0.3, 2.0])
    area = math.pi * radius**2
    rows = np.zeros((5, 16))
    rows[:, 3] = area
    rows[:, 5], rows[:, 9], rows[:, 13] = 1, distance, -1
    body = f"result[0] = valIrradiance(a.xyz, b.xyz, c.xyz, d.xyz, a.w, vec3({area:.9f})).x;"
    found = run(body, rows, 1)[:, 0]
    np.testing.assert_allclose(found[1:], (math.pi * radius**2 / (distance**2 + radius**2))[1:], rtol=1e-5)
    assert found[0] == 0
    assert np.isfinite(found).all()
