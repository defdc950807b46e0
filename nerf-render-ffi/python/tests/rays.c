#include "nerf_render.h"
#include <stdlib.h>
#include <time.h>

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* What the package's Scene.rays does, in C. `rays`: six floats each, origin and direction; `seen`: planes of colour, opacity
 * and ray_distance. Returns the seconds of this thread; below 0 on any error. */
double rays_in_c(const nerf_scene *scene, const float *rays, size_t count, float *seen) {
    const double start = now();
    nerf_target target = {.struct_size = sizeof target, .rgb = {.data = seen, .format = NERF_FORMAT_RGB_F32},
        .opacity = {.data = seen + 3 * count, .format = NERF_FORMAT_F32},
        .ray_distance = {.data = seen + 4 * count, .format = NERF_FORMAT_F32}};
    nerf_request request = {.struct_size = sizeof request, .scene = scene,
        .outputs = NERF_OUTPUT_RGB | NERF_OUTPUT_OPACITY | NERF_OUTPUT_RAY_DISTANCE};
    nerf_rays call = {.struct_size = sizeof call, .count = count, .origins = {rays, 6 * sizeof *rays},
        .dirs = {rays + 3, 6 * sizeof *rays}, .target = &target};
    size_t size, align;
    nerf_worker *worker;
    if (nerf_worker_size(&request, &size, &align, NULL, 0)) return -1;
    void *memory = aligned_alloc(align, (size + align - 1) / align * align);
    if (nerf_worker_open(&request, memory, size, &worker, NULL, 0)) return -1;
    if (nerf_render_rays(worker, &call, NULL, NULL, 0)) return -1;
    free(memory);
    return now() - start;
}
