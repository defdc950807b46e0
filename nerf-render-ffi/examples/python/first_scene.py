"""From nothing to pictures of a scene, in cells for a notebook. Needs the wheel and matplotlib."""

# %% Fit a scene. Of photographs of your own: nerf-train poses FOLDER, then nerf-train fit FOLDER_poses -o mine.nerf
import subprocess
import sysconfig

import matplotlib.pyplot as plt
import nerf_render as nerf
import numpy as np

program = sysconfig.get_path("scripts") + "/nerf-train"
subprocess.run([program, "--quiet", "demo", "--steps", "1500", "--out", "demo"], check=True)

# %% Look at it from where the photographs were taken.
scene = nerf.Scene("demo/demo.nerf")
start = scene.render(400, 400, outputs=["rgb", "opacity", "z_depth", "normals"])
_, axes = plt.subplots(1, 4, figsize=(16, 4))
for axis, (name, array) in zip(axes, start.items()):
    axis.imshow(0.5 + 0.5 * array if name == "normals" else array.clip(0, None))
    axis.set_title(name)

# %% Walk around it, with pictures in an array of your own.
centre = 0.5 * (np.array(scene.info["box_min"]) + scene.info["box_max"])
radius = 0.5 * (scene.info["near_distance"] + scene.info["far_distance"])
views = np.empty((8, 200, 200, 3), np.uint8)
_, axes = plt.subplots(1, 8, figsize=(16, 2))
for axis, view, angle in zip(axes, views, np.linspace(0, 2 * np.pi, 8, endpoint=False)):
    eye = centre + radius * np.array([0.9 * np.cos(angle), 0.9 * np.sin(angle), 0.4])
    scene.render(200, 200, nerf.look_at(eye, centre), out={"rgb": view})
    axis.imshow(view)

# %% Rays of your own, straight down: how high the scene is.
x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 300)])
above = centre + radius * np.stack([0.5 * x, 0.5 * y, 0 * x + 1], -1)
down = scene.rays(above, [0, 0, -1], t_max=2 * radius)
_, axes = plt.subplots(1, 2, figsize=(8, 4))
axes[0].imshow(down.rgb.clip(0, None), origin="lower")
axes[1].imshow(radius - down.ray_distance, origin="lower")
plt.show()
