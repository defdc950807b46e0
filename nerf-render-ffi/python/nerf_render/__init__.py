"""Renders radiance fields (`.nerf` files) into numpy arrays, on all cores of a CPU.

>>> import nerf_render as nerf
>>> scene = nerf.Scene("demo.nerf")
>>> picture = scene.render(400, 400)           # from where the photographs were taken
>>> picture.rgb.shape, picture.ray_distance.shape
((400, 400, 3), (400, 400))

World units throughout; right-handed; a camera looks down -Z, +Y is up, +X is right, as in OpenGL and Blender.
Pixel `[0, 0]` is top left. Colour is display-encoded (sRGB), over the scene's background. Arrays are float32.

`Scene.render` renders a camera's image, `Scene.rays` given rays; `Scene.points` evaluates density and colour at points.
A call that the library refuses raises `Error`; a wrong type or shape of an argument raises `TypeError` or `ValueError`.
The program `nerf-train`, which fits, renders and exports scenes, is installed with the package.
"""

from ._abi import Error, library
from ._scene import Result, Scene, look_at

__all__ = ["Error", "Result", "Scene", "look_at"]
__version__: str = library.nerf_version_text().decode()
