"""The wheel as it is installed: its program, its metadata, its weight."""

import importlib.metadata
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import nerf_render as nerf
import numpy as np


def run(*command, **options):
    return subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def test_the_package_says_its_version_and_needs_numpy_alone(program):
    assert nerf.__version__ == importlib.metadata.version("nerf-render")
    assert run(program, "--version").stdout == f"nerf-train {nerf.__version__}\n"
    requires = importlib.metadata.requires("nerf-render")
    assert [name.split(">")[0] for name in requires] == ["numpy"]
    files = {str(file) for file in importlib.metadata.files("nerf-render")}
    assert {"nerf_render/py.typed", "nerf_render/libnerf_render.so"} <= files


def test_the_programs_status_and_signals_pass_through(program, tmp_path):
    assert run(program, "inspect", tmp_path / "nowhere.nerf").returncode == 1
    assert run(program, "no-such-command").returncode == 2
    fit = [program, "--quiet", "demo", "--steps", "1000000", "--out", tmp_path / "demo"]
    for number in (signal.SIGTERM, signal.SIGINT):
        child = subprocess.Popen(fit, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(1.0)
        child.send_signal(number)
        assert child.wait(timeout=60) == 128 + number


def test_the_programs_commands_work_and_its_start_view_is_the_packages(program, path, tmp_path):
    assert run(program, "inspect", path).returncode == 0
    picture = tmp_path / "view.png"
    made = run(program, "--quiet", "render", path, "-o", picture, "--width", "48", "--height", "48")
    assert made.returncode == 0, made.stderr
    mesh = run(program, "--quiet", "export", path, "-o", tmp_path / "mesh.ply", "--resolution", "16")
    assert mesh.returncode == 0 and (tmp_path / "mesh.ply").stat().st_size > 0, mesh.stderr
    poses = run(program, "poses", tmp_path / "nowhere")
    assert poses.returncode == 1 and "nowhere" in poses.stderr
    fit = run(program, "fit", tmp_path / "nowhere", "-o", tmp_path / "fit.nerf")
    assert fit.returncode == 1 and "nowhere" in fit.stderr
    ours = np.zeros((48, 48, 3), np.uint8)
    nerf.Scene(path).render(48, 48, out={"rgb": ours})
    assert np.array_equal(read_png(picture), ours)


def read_png(path):
    """`[h, w, 3]`: an RGB picture of 8 bits, of the filters that there are."""
    import struct
    import zlib

    data, place, packed = path.read_bytes(), 8, b""
    while place < len(data):
        (length,), kind = struct.unpack(">I", data[place : place + 4]), data[place + 4 : place + 8]
        body, place = data[place + 8 : place + 8 + length], place + 12 + length
        if kind == b"IHDR":
            width, height, depth, colour = struct.unpack(">IIBB", body[:10])
            assert (depth, colour) == (8, 2)
        packed += body if kind == b"IDAT" else b""
    rows = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, 1 + 3 * width).astype(int)
    picture = np.zeros((height + 1, width + 1, 3), int)
    for y, row in enumerate(rows):
        for x in range(width):
            left, up, corner = picture[y + 1, x], picture[y, x + 1], picture[y, x]
            guess = left + up - corner
            off = abs(np.stack([left, up, corner]) - guess)
            paeth = np.where((off[0] <= off[1]) & (off[0] <= off[2]), left, np.where(off[1] <= off[2], up, corner))
            filtered = [0, left, up, (left + up) // 2, paeth][row[0]]
            picture[y + 1, x + 1] = (row[1 + 3 * x : 4 + 3 * x] + filtered) & 255
    return picture[1:, 1:].astype(np.uint8)


def test_the_example_runs(program, tmp_path):
    """With pictures where matplotlib is installed, and in short."""
    example = Path(__file__).resolve().parents[2] / "examples" / "python" / "first_scene.py"
    code = example.read_text().replace('"--steps", "1500"', '"--steps", "20"')
    assert '"--steps", "20"' in code
    stand_in = tmp_path / "matplotlib"
    stand_in.mkdir()
    (stand_in / "__init__.py").write_text("")
    (stand_in / "pyplot.py").write_text(
        "import numpy as np\n"
        "class Axes:\n"
        "    def imshow(self, array, **_): assert np.isfinite(array).all() and array.max() > array.min()\n"
        "    def set(self, **_): pass\n"
        "    set_title = axis = lambda self, *_: None\n"
        "def subplots(rows, columns, **_): return None, [Axes() for _ in range(rows * columns)]\n"
        "def show(): print('shown')\n"
    )
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"}
    done = run(sys.executable, "-c", code, cwd=tmp_path, env=environment)
    assert done.returncode == 0 and done.stdout.endswith("shown\n"), done.stderr
