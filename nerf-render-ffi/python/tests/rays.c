/* Renders rays as the package does: rays SCENE IN OUT REPEATS. IN holds six floats a ray, origin and direction; OUT gets five,
 * colour, opacity and ray_distance, in three planes. Says the fewest seconds of its thread that it took of REPEATS. */
#include "nerf_render.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(int count, char **arguments) {
    if (count != 5) return 2;
    FILE *in = fopen(arguments[2], "rb"), *to = fopen(arguments[3], "wb");
    if (in == NULL || to == NULL || fseek(in, 0, SEEK_END) != 0) return 1;
    const size_t rays = (size_t)ftell(in) / (6 * sizeof(float));
    rewind(in);
    float *read = malloc(6 * rays * sizeof *read), *seen = malloc(5 * rays * sizeof *seen);
    if (fread(read, 6 * sizeof *read, rays, in) != rays) return 1;
    const nerf_scene *scene;
    if (nerf_scene_open_file(arguments[1], NULL, &scene, NULL, 0)) return 1;
    nerf_target target = {.struct_size = sizeof target, .rgb = {.data = seen, .format = NERF_FORMAT_RGB_F32},
        .opacity = {.data = seen + 3 * rays, .format = NERF_FORMAT_F32},
        .ray_distance = {.data = seen + 4 * rays, .format = NERF_FORMAT_F32}};
    nerf_request request = {.struct_size = sizeof request, .scene = scene,
        .outputs = NERF_OUTPUT_RGB | NERF_OUTPUT_OPACITY | NERF_OUTPUT_RAY_DISTANCE};
    nerf_rays call = {.struct_size = sizeof call, .count = rays, .origins = {read, 6 * sizeof *read},
        .dirs = {read + 3, 6 * sizeof *read}, .target = &target};
    double fewest = 1e9;
    for (int i = 0; i < atoi(arguments[4]); ++i) {
        const double start = now();
        size_t size, align;
        nerf_worker *worker;
        if (nerf_worker_size(&request, &size, &align, NULL, 0)) return 1;
        void *memory = aligned_alloc(align, (size + align - 1) / align * align);
        if (nerf_worker_open(&request, memory, size, &worker, NULL, 0)) return 1;
        if (nerf_render_rays(worker, &call, NULL, NULL, 0)) return 1;
        free(memory);
        const double took = now() - start;
        if (took < fewest) fewest = took;
    }
    if (fwrite(seen, 5 * sizeof *seen, rays, to) != rays || fclose(to) != 0) return 1;
    printf("%.9f\n", fewest);
    nerf_scene_close(scene);
    return 0;
}
