"""What is refused, with a sentence, and never by the end of the interpreter."""

import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
import time

import nerf_render as nerf
import numpy as np
import pytest

F4 = np.float32


def test_files_that_are_missing_or_damaged(path, tmp_path):
    damaged = tmp_path / "damaged.nerf"
    whole = path.read_bytes()
    with pytest.raises(nerf.Error, match="nowhere.nerf: expected a file that can be read") as error:
        nerf.Scene(tmp_path / "nowhere.nerf")
    assert error.value.status == 20
    with pytest.raises(nerf.Error, match=str(tmp_path)):
        nerf.Scene(str(tmp_path))
    for length in [0, 1, 7, 8, 64, 1000, len(whole) // 2, len(whole) - 1]:
        damaged.write_bytes(whole[:length])
        with pytest.raises(nerf.Error, match="damaged.nerf: "):
            nerf.Scene(damaged)
    for place in range(0, len(whole), len(whole) // 50):
        damaged.write_bytes(whole[:place] + bytes([whole[place] ^ 0x10]) + whole[place + 1 :])
        with pytest.raises(nerf.Error, match="damaged.nerf: "):
            nerf.Scene(os.fsencode(damaged))
    damaged.write_bytes(whole + b"x")
    with pytest.raises(nerf.Error):
        nerf.Scene(damaged)
    for wrong in (None, 5, 1.5, [path]):
        with pytest.raises(TypeError):
            nerf.Scene(wrong)
    with pytest.raises(ValueError, match="NUL"):
        nerf.Scene(f"{path}\0")


def test_errors_can_be_pickled():
    error = pickle.loads(pickle.dumps(nerf.Error(20, "a sentence")))
    assert (error.status, str(error)) == (20, "a sentence")


@pytest.mark.parametrize(
    ("kind", "sentence", "arguments"),
    [
        (ValueError, "width: expected 1 to 8388608, found 0", {"width": 0}),
        (ValueError, "width: expected 1 to 8388608, found -1", {"width": -1}),
        (ValueError, "height: expected 1 to 8388608, found 4294967304", {"height": 2**32 + 8}),
        (TypeError, "float", {"width": 8.0}),
        (MemoryError, "Unable to allocate", {"width": 1 << 23, "height": 1 << 23}),
        (ValueError, "fov: .* found 0", {"fov": 0}),
        (ValueError, "fov: .* found 180", {"fov": 180}),
        (ValueError, "fov: .* found nan", {"fov": np.nan}),
        (TypeError, "'str'", {"fov": "40"}),
        (ValueError, r"c2w: expected the shape \(3, 4\) or \(4, 4\), found \(4, 3\)", {"c2w": np.zeros((4, 3))}),
        (ValueError, "c2w: expected the last row 0 0 0 1", {"c2w": np.ones((4, 4))}),
        (TypeError, "c2w: expected real numbers, found complex128", {"c2w": np.zeros((3, 4), complex)}),
        (nerf.Error, "camera", {"c2w": np.zeros((3, 4))}),
        (nerf.Error, "camera", {"c2w": np.full((3, 4), np.nan)}),
        (ValueError, "threads: expected 1 to", {"threads": 0}),
        (TypeError, "float", {"threads": 1.5}),
        (ValueError, "outputs: expected some of rgb, opacity, .* found 'depth'", {"outputs": ["depth"]}),
        (ValueError, "outputs: .* found 'sigma'", {"outputs": "sigma"}),
        (TypeError, "out: expected arrays by name, found ndarray", {"out": np.zeros((8, 8, 3), F4)}),
        (ValueError, "outputs: expected some of", {"out": {"colour": np.zeros((8, 8, 3), F4)}}),
        (TypeError, r"out\['rgb'\]: expected a numpy array, found list", {"out": {"rgb": [[0.0]]}}),
        (ValueError, r"out\['rgb'\]: expected float32 \(8, 8, 3\) or", {"out": {"rgb": np.zeros((8, 9, 3), F4)}}),
        (ValueError, r"found float32 \(3, 8, 8\)", {"out": {"rgb": np.zeros((3, 8, 8), F4)}}),
        (ValueError, r"found float64 \(8, 8, 3\)", {"out": {"rgb": np.zeros((8, 8, 3))}}),
        (ValueError, r"found >f4 \(8, 8\)", {"out": {"opacity": np.zeros((8, 8), ">f4")}}),
        (ValueError, r"found float32 \(8, 8, 1\)", {"out": {"opacity": np.zeros((8, 8, 1), F4)}}),
        (ValueError, "channels side by side", {"out": {"rgb": np.zeros((8, 8, 3), F4, order="F")}}),
        (ValueError, "pixels in rows", {"out": {"opacity": np.zeros((8, 8), F4).T}}),
        (ValueError, "pixels in rows", {"out": {"opacity": np.zeros((8, 8), F4)[:, ::-1]}}),
        (
            ValueError,
            "rows apart",
            {"out": {"opacity": np.lib.stride_tricks.as_strided(np.zeros(64, F4), (8, 8), (0, 4), writeable=True)}},
        ),
        (
            nerf.Error,
            "expected a multiple of 4",
            {"out": {"opacity": np.zeros(260, np.uint8)[1:257].view(F4).reshape(8, 8)}},
        ),
    ],
)
def test_render_refuses(scene, kind, sentence, arguments):
    with pytest.raises(kind, match=sentence):
        scene.render(**{"width": 8, "height": 8, **arguments})


def test_outputs_that_are_read_only(scene, rays):
    array = np.zeros((8, 8, 3), F4)
    array.flags.writeable = False
    with pytest.raises(ValueError, match=r"out\['rgb'\]: expected an array to write to, found a read-only one"):
        scene.render(8, 8, out={"rgb": array})
    with pytest.raises(ValueError, match="read-only"):
        scene.rays(*rays, out={"opacity": np.broadcast_to(F4(0), (50, 50))})
    assert not array.any()


def test_outputs_that_share_memory(scene, rays):
    origins, dirs = rays
    plane = np.zeros((9, 8), F4)
    with pytest.raises(ValueError, match=r"out\['z_depth'\]: expected memory of its own, found that of out\['opacity'\]"):
        scene.render(8, 8, out={"opacity": plane[1:], "z_depth": plane[:-1]})
    with pytest.raises(ValueError, match=r"out\['rgb'\]: expected memory of its own, found that of dirs"):
        scene.rays(origins, dirs, out={"rgb": dirs})
    with pytest.raises(ValueError, match="found that of t_max"):
        scene.rays(origins, dirs, 0, (t := np.ones((50, 50), F4)), out={"opacity": t})
    assert not plane.any()


@pytest.mark.parametrize(
    ("kind", "sentence", "arguments"),
    [
        (ValueError, r"origins: expected the shape \(\.\.\., 3\), found \(3, 100\)", (np.zeros((3, 100)), np.zeros((3, 100)))),
        (ValueError, r"origins: expected the shape \(\.\.\., 3\), found \(\)", (0.0, np.zeros((3, 3)))),
        (ValueError, "dirs: expected the shape", (np.zeros((4, 3)), np.zeros((5, 3)))),
        (ValueError, "dirs: expected the shape", (np.zeros((2, 4, 3)), np.zeros((4, 3)))),
        (TypeError, "dirs: expected real numbers, found bool", (np.zeros((4, 3)), np.ones((4, 3), bool))),
        (TypeError, "origins: expected real numbers, found object", (np.array([[None] * 3]), np.zeros((1, 3)))),
        (TypeError, "origins: expected real numbers, found <U1", ([["a", "b", "c"]], np.zeros((1, 3)))),
        (nerf.Error, r"rays\[0\]: .* direction of unit length", (np.zeros((4, 3)), np.zeros((4, 3)))),
        (nerf.Error, r"rays\[0\]: expected a finite origin", (np.full((4, 3), np.nan), [0, 0, 1])),
        (nerf.Error, r"rays\[0\]", (np.zeros((4, 3)), [0, 0, 1], -1.0)),
        (nerf.Error, r"rays\[0\]", (np.zeros((4, 3)), [0, 0, 1], 2.0, 1.0)),
        (nerf.Error, r"rays\[0\]", (np.zeros((4, 3)), [0, 0, 1], np.nan)),
        (ValueError, r"t_max: expected the shape \(4,\) or \(\), found \(5,\)", (np.zeros((4, 3)), [0, 0, 1], 0, np.ones(5))),
        (ValueError, r"t_min: expected the shape \(4,\) or \(\), found \(4, 1\)", (np.zeros((4, 3)), [0, 0, 1], np.ones((4, 1)))),
    ],
)
def test_rays_refuses(scene, kind, sentence, arguments):
    with pytest.raises(kind, match=sentence):
        scene.rays(*arguments)


def test_the_ray_or_point_that_is_wrong_is_named_by_its_number_among_all(scene):
    places, dirs = np.zeros((5000, 3), F4), np.tile(np.array([0, 0, 1], F4), (5000, 1))
    dirs[4321] *= 2
    dirs[4700] *= 2
    for threads in (1, 4):
        with pytest.raises(nerf.Error, match=r"rays\[4321\]") as error:
            scene.rays(places, dirs, threads=threads)
        assert error.value.status == 22
        with pytest.raises(nerf.Error, match="4321") as error:
            scene.points(places, dirs, threads=threads)
        assert error.value.status == 15


def test_rays_and_points_refuse_outputs(scene, rays):
    with pytest.raises(ValueError, match="axis: expected three numbers, along which z_depth is measured"):
        scene.rays(*rays, outputs=["z_depth"])
    with pytest.raises(ValueError, match=r"axis: expected the shape \(3,\)"):
        scene.rays(*rays, axis=[1, 0])
    with pytest.raises(nerf.Error, match="axis"):
        scene.rays(*rays, axis=[1, 1, 0])
    with pytest.raises(ValueError, match="found strides"):
        scene.rays(*rays, out={"opacity": np.zeros((50, 60), F4)[:, :50]})
    with pytest.raises(ValueError, match="outputs: expected some of sigma, found 'rgb'"):
        scene.points(rays[0], out={"rgb": np.zeros((50, 50, 3), F4)})
    with pytest.raises(nerf.Error, match="rgb"):
        scene.points(*rays, out={"rgb": np.zeros((50, 50, 3), np.uint8)})
    with pytest.raises(ValueError, match=r"xyz: expected the shape \(\.\.\., 3\)"):
        scene.points([1.0, 2.0])


def test_views_there_are_none_of():
    with pytest.raises(nerf.Error, match="eye, target, up"):
        nerf.look_at([0, 0, 0], [0, 0, 0])
    with pytest.raises(nerf.Error, match="eye, target, up"):
        nerf.look_at([0, 0, 0], [0, 0, 1])
    with pytest.raises(ValueError, match=r"eye: expected the shape \(3,\), found \(2,\)"):
        nerf.look_at([0, 0], [0, 0, 1])


def test_a_scene_that_was_closed(path, rays):
    with nerf.Scene(path) as scene:
        pass
    scene.close()
    for draw in (lambda: scene.render(8, 8), lambda: scene.rays(*rays), lambda: scene.points(rays[0])):
        with pytest.raises(ValueError, match="scene: expected an open one, found one that was closed"):
            draw()


@pytest.mark.parametrize("threads", [1, 4])
def test_a_scene_that_is_closed_while_it_draws(path, threads):
    for wait in np.linspace(0.001, 0.1, 12):
        scene, ends = nerf.Scene(path), []

        def draw(scene=scene, ends=ends):
            try:
                ends.append(scene.render(3000, 3000, outputs="rgb", threads=threads))
            except ValueError as error:
                ends.append(error)

        drawing = threading.Thread(target=draw)
        drawing.start()
        time.sleep(wait)
        scene.close()
        drawing.join()
        assert isinstance(ends[0], ValueError) and "closed" in str(ends[0])
        del scene, ends


def test_ctrl_c_ends_a_long_picture(path):
    code = (
        "import nerf_render as nerf, sys, time\n"
        f"scene = nerf.Scene({str(path)!r})\n"
        "print('begins', flush=True)\n"
        "try: scene.render(6000, 6000, outputs='opacity')\n"
        "except KeyboardInterrupt: print('ended')"
    )
    child = subprocess.Popen([sys.executable, "-X", "dev", "-c", code], stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "begins\n"
    time.sleep(0.5)
    child.send_signal(2)
    assert child.communicate(timeout=60)[0] == "ended\n" and child.returncode == 0


def test_a_process_that_was_forked_draws_the_same(scene, rays):
    expected = scene.render(64, 64, threads=3), scene.rays(*rays, threads=3)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            again = scene.render(64, 64, threads=3), scene.rays(*rays, threads=3)
            pairs = [(a[name], b[name]) for a, b in zip(expected, again) for name in a]
            scene.close()
            status = 0 if all(np.array_equal(a, b) for a, b in pairs) else 2
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert np.array_equal(scene.render(64, 64).rgb, expected[0].rgb)


def test_a_process_that_was_forked_while_others_draw(path):
    """No lock is held that the child would wait for."""
    code = (
        "import nerf_render as nerf, os, threading\n"
        f"scene = nerf.Scene({str(path)!r})\n"
        "drawing = threading.Thread(target=scene.render, args=(1500, 1500), kwargs={'threads': 2})\n"
        "drawing.start()\n"
        "child = os.fork()\n"
        "picture = scene.render(32, 32, threads=2).rgb\n"
        "if child == 0: os._exit(0 if picture.max() > 0 else 1)\n"
        "status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])\n"
        "drawing.join()\n"
        "raise SystemExit(status)"
    )
    subprocess.run([sys.executable, "-W", "ignore", "-X", "faulthandler", "-c", code], check=True, timeout=120)


def _mean(scene):
    return float(scene.render(16, 16).rgb.mean())


def test_workers_of_multiprocessing_draw(path):
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        means = pool.map(_draw_file, [str(path)] * 4)
    assert means == [_mean(nerf.Scene(path))] * 4


def _draw_file(path):
    return _mean(nerf.Scene(path))
