"""What arrays hold, where they lie, and that bits depend on nothing else."""

import re
import shutil
import threading
import time
from pathlib import Path

import bench_rays
import nerf_render as nerf
import numpy as np
import pytest
from nerf_render import _abi

NAMES = ["rgb", "opacity", "ray_distance", "z_depth", "median_distance", "normals"]
HEADER = Path(__file__).resolve().parents[3] / "include" / "nerf_render.h"


def same(a, b):
    assert list(a) == list(b)
    return all(np.array_equal(a[name], b[name]) for name in a)


def test_a_picture_has_arrays_by_name_in_float32(scene):
    picture = scene.render(70, 40)
    assert list(picture) == ["rgb", "opacity", "ray_distance", "z_depth"]
    assert picture.rgb is picture["rgb"] and picture.rgb.shape == (40, 70, 3)
    assert {array.dtype for array in picture.values()} == {np.dtype(np.float32)}
    everything = scene.render(70, 40, outputs=NAMES)
    assert [everything[name].shape[2:] for name in NAMES] == [(3,), (), (), (), (), (3,)]
    assert np.array_equal(everything.rgb, picture.rgb)
    assert everything.opacity.max() > 0.5 and 0.0 <= everything.opacity.min()
    length = np.linalg.norm(everything.normals, axis=-1)
    assert np.all((abs(length - 1.0) < 1e-4) | (length == 0.0)) and length.max() > 0.5
    with pytest.raises(AttributeError, match="normals: expected one of rgb"):
        picture.normals


def test_bits_do_not_depend_on_threads(scene, rays):
    assert same(scene.render(100, 70, threads=1), scene.render(100, 70, threads=7))
    assert same(scene.rays(*rays, threads=1), scene.rays(*rays, threads=5))
    assert same(scene.points(*rays, threads=1), scene.points(*rays, threads=5))


def test_c2w_and_fov_say_what_is_seen(scene):
    info = scene.info
    middle = 0.5 * (np.array(info["box_min"]) + info["box_max"])
    c2w = nerf.look_at(middle + [0.0, -4.0, 0.5], middle)
    assert np.allclose(c2w[:, 3], middle + [0.0, -4.0, 0.5]) and np.allclose(c2w[:, :3].T @ c2w[:, :3], np.eye(3), atol=1e-6)
    whole = np.vstack([c2w, [0, 0, 0, 1]])
    assert same(scene.render(30, 20, c2w), scene.render(30, 20, whole.tolist(), fov=40))
    assert not same(scene.render(30, 20, c2w), scene.render(30, 20, c2w, fov=60.0))
    half = 2 * np.degrees(np.arctan(0.5 * np.tan(np.radians(20.0))))
    assert np.allclose(scene.render(60, 40, c2w).rgb[10:30, 15:45], scene.render(30, 20, c2w, half).rgb, atol=1e-4)


def test_rays_of_a_camera_give_its_pixels(scene):
    c2w = np.eye(3, 4, dtype=np.float32)
    c2w[:, 3] = 0.5 * (np.array(scene.info["box_min"]) + scene.info["box_max"]) + [0.0, 0.0, 4.0]
    focal = np.float32(0.5 * 40 / np.tan(np.radians(20.0)))
    x, y = np.meshgrid((np.arange(40) + 0.5 - 20), (np.arange(30) + 0.5 - 15))
    dirs = np.stack([x / focal, -y / focal, -np.ones_like(x)], -1)
    dirs /= np.linalg.norm(dirs, axis=-1, keepdims=True)
    seen, picture = scene.rays(c2w[:, 3], dirs, axis=[0, 0, -1]), scene.render(40, 30, c2w)
    assert list(seen) == list(picture) and picture.opacity.max() > 0.5
    for name in seen:
        assert seen[name].shape == picture[name].shape
        # The camera rounds its directions in f32.
        assert np.mean(abs(seen[name] - picture[name]) < 2e-3) > 0.99


@pytest.mark.skipif(shutil.which("cc") is None, reason="no cc")
def test_rays_from_numpy_are_those_in_c_bit_for_bit(scene, tmp_path):
    records = bench_rays.camera_rays(scene, 128).reshape(-1, 6)
    _, in_c = bench_rays.compiled(tmp_path)(scene, records)
    result = scene.rays(records[:, :3], records[:, 3:])
    assert [np.array_equal(a, b) for a, b in zip(in_c, result.values())] == [True] * 3
    assert result.opacity.max() > 0.5


def test_rays_and_points_take_any_shape_and_numbers(scene, rays):
    origins, dirs = rays
    expected = scene.rays(origins, dirs)
    flat = scene.rays(origins.reshape(-1, 3), dirs.reshape(-1, 3))
    assert expected.rgb.shape == (50, 50, 3) and np.array_equal(flat.rgb.reshape(50, 50, 3), expected.rgb)
    for origins_too, dirs_too in [
        (origins[0, 0], dirs),
        (origins.astype(float), dirs.astype(">f4")),
        (origins.tolist(), np.asfortranarray(dirs)),
        (np.repeat(origins, 2, 1)[:, ::2], dirs[::-1].copy()[::-1]),
        (np.repeat(origins, 2, -1)[..., ::2], np.frombuffer(b"\0" + dirs.tobytes(), np.uint8)[1:].view("<f4").reshape(dirs.shape)),
    ]:
        assert same(scene.rays(origins_too, dirs_too), expected)
    assert scene.rays(origins[0, 0], dirs[20, 20]).rgb.shape == (3,)
    assert scene.rays(np.empty((0, 3)), np.empty((0, 3))).rgb.shape == (0, 3)
    integer = scene.points(np.zeros((4, 3), int), [0, 0, 1])
    assert integer.sigma.shape == (4,) and integer.rgb.shape == (4, 3)
    assert list(scene.points([[0.0, 0.0, 0.0]])) == ["sigma"]


def test_t_min_and_t_max_cut_rays(scene, rays):
    whole = scene.rays(*rays)
    assert same(scene.rays(*rays, 0.0, np.inf), whole) and same(scene.rays(*rays, t_max=1e300), whole)
    assert scene.rays(*rays, t_max=0.01).opacity.max() == 0.0
    middle = float(np.median(whole.ray_distance[whole.opacity > 0.5]))
    each = np.full((50, 50), middle)
    near, far = scene.rays(*rays, 0, each), scene.rays(*rays, each, np.inf)
    assert same(near, scene.rays(*rays, t_max=middle))
    assert 0 < near.opacity.sum() < whole.opacity.sum() and 0 < far.opacity.sum() < whole.opacity.sum()


def test_arrays_of_the_caller_are_read_and_written_where_they_lie(scene, rays):
    fields = [("origin", "f4", 3), ("dir", "f4", 3), ("rgb", "f4", 3), ("opacity", "f4"), ("id", "i4")]
    records = np.zeros((50, 50), fields)
    records["origin"], records["dir"], records["id"] = *rays, 7
    column = nerf._arrays.Column.of("origins", records["origin"], (50, 50, 3), 3)
    assert np.shares_memory(column.array, records)
    result = scene.rays(records["origin"], records["dir"], out={"rgb": records["rgb"], "opacity": records["opacity"]})
    assert list(result) == ["rgb", "opacity"] and np.shares_memory(result.rgb, records)
    expected = scene.rays(*rays)
    assert np.array_equal(records["rgb"], expected.rgb) and np.array_equal(records["opacity"], expected.opacity)
    assert np.array_equal(records["dir"], rays[1]) and np.all(records["id"] == 7)


def test_pictures_go_into_arrays_of_the_caller(scene):
    expected = scene.render(50, 30, outputs=["rgb", "opacity", "normals"])
    canvas = np.full((60, 100, 4), 9.0, np.float32)
    half = canvas[10:40, 20:70]
    depth = np.empty((30, 50), np.float32)[::-1]
    result = scene.render(50, 30, out={"rgb": half[..., :3], "z_depth": depth}, outputs=["normals"])
    assert sorted(result) == ["normals", "rgb", "z_depth"] and result.z_depth is depth
    assert np.array_equal(half[..., :3], expected.rgb) and np.array_equal(result.normals, expected.normals)
    half[..., :3] = 9.0
    assert np.all(canvas == 9.0)
    bytes3, bytes4 = np.zeros((30, 50, 3), np.uint8), np.zeros((30, 50, 4), np.uint8)
    scene.render(50, 30, out={"rgb": bytes3})
    scene.render(50, 30, out={"rgb": bytes4})
    assert np.array_equal(bytes3, (np.clip(expected.rgb, 0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8))
    assert np.array_equal(bytes4[..., 3], (expected.opacity * np.float32(255) + np.float32(0.5)).astype(np.uint8))


def test_the_gil_is_free_while_a_scene_draws(scene, monkeypatch):
    monkeypatch.setattr(nerf._scene, "_TILE", 1 << 20)  # one call for all of the picture
    ended, counted = threading.Event(), 0

    def draw():
        scene.render(500, 500, outputs="rgb", threads=1)
        ended.set()

    drawing = threading.Thread(target=draw)
    drawing.start()
    while not ended.is_set():
        time.sleep(1e-4)
        counted += 1
    drawing.join()
    assert counted > 20


def test_the_scene_says_what_it_is(scene):
    info = scene.info
    assert info["kind"] == 1 and len(info["box_min"]) == 3 and isinstance(info["made_by"], str)
    assert info["near_distance"] < info["far_distance"]


@pytest.mark.skipif(not HEADER.exists(), reason="no nerf_render.h")
def test_structures_are_those_of_the_header():
    text = re.sub(r"/\*.*?\*/", "", HEADER.read_text(), flags=re.S)
    names = {"Text", "Plane", "Floats", "Rect", "SceneInfo", "Camera", "Request", "Target", "Frame", "Rays", "Points"}
    types = {
        "size_t": "c_ulong", "ptrdiff_t": "c_long", "uint32_t": "c_uint", "float": "c_float", "uint64_t": "c_ulong",
        "nerf_text": "Text", "nerf_floats": "Floats", "nerf_plane": "Plane",
    }
    for name in names:
        tag = "nerf_" + re.sub("(?<=[a-z])(?=[A-Z])", "_", name).lower()
        body = re.search(rf"typedef struct {tag} {{(.*?)}} {tag};", text, re.S)[1]
        expected = []
        for kind, star, field, _, length in re.findall(r"(\w+) (\*?)(\w+)(\[(\d+)\])?;", body):
            pointer = star or kind == "nerf_progress"
            expected.append((field, "pointer" if pointer else types[kind] + (f"_Array_{length}" if length else "")))
        found = [
            (field, "pointer" if kind.__name__ == "c_void_p" or kind.__name__.startswith("LP_") else kind.__name__)
            for field, kind in getattr(_abi, name)._fields_
        ]
        assert found == expected, name
    assert f"#define NERF_ABI_VERSION {_abi.ABI_VERSION}\n" in HEADER.read_text()
    for name, bit in nerf._arrays.OUTPUTS.items():
        assert re.search(rf"#define NERF_OUTPUT_{name.upper()} {bit}\n", text)
    for name in ("DIRECTION", "RAY"):
        assert f"NERF_STATUS_{name} = {getattr(_abi, 'STATUS_' + name)}," in text
