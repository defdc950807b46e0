// A host without a heap: everything is lent. What it leaves for the linker to find is looked at.
#include "nerf_render.hpp"

extern const unsigned char blob[];
extern const unsigned blob_size;

alignas(64) static unsigned char home[4096], workspace[65536];
static float z_depth[64];

int draw() {
    const auto scene = nerf::scene::open(nerf::bytes(blob, blob_size), nerf::memory::lend(home), NERF_KERNEL_PORTABLE);
    if (!scene) {
        return scene.status();
    }
    nerf::camera camera(8, 8, 10.0f);
    camera.orbit(scene->centre(), scene->orbit_radius(), 0.0f, 0.3f);
    nerf::target target;
    target.z_depth = nerf::plane::f32(z_depth);
    auto worker = scene->worker(target.outputs(), {}, nerf::memory::lend(workspace));
    return worker ? worker->render(camera, target).status() : worker.status();
}
