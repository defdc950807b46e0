/* Counts what the library allocates from the first call to the last: nothing. */
#include "nerf_render.h"

#include <stdio.h>
#include <stdlib.h>

static volatile long allocations;

void *__real_malloc(size_t size);
void *__wrap_malloc(size_t size);
void *__real_calloc(size_t count, size_t size);
void *__wrap_calloc(size_t count, size_t size);
void *__real_realloc(void *at, size_t size);
void *__wrap_realloc(void *at, size_t size);
int __real_posix_memalign(void **at, size_t align, size_t size);
int __wrap_posix_memalign(void **at, size_t align, size_t size);
void *__real_aligned_alloc(size_t align, size_t size);
void *__wrap_aligned_alloc(size_t align, size_t size);

void *__wrap_malloc(size_t size) { allocations += 1; return __real_malloc(size); }
void *__wrap_calloc(size_t count, size_t size) { allocations += 1; return __real_calloc(count, size); }
void *__wrap_realloc(void *at, size_t size) { allocations += 1; return __real_realloc(at, size); }
int __wrap_posix_memalign(void **at, size_t align, size_t size) { allocations += 1; return __real_posix_memalign(at, align, size); }
void *__wrap_aligned_alloc(size_t align, size_t size) { allocations += 1; return __real_aligned_alloc(align, size); }

static _Alignas(64) unsigned char blob[1 << 20], memory[1 << 22], workspace[1 << 23];
static float picture[32 * 32 * 4];
static char text[4096];

int main(void) {
    size_t length = fread(blob, 1, sizeof blob, stdin), size, align;
    char message[128];
    const nerf_scene *scene;
    nerf_worker *worker;
    nerf_scene_info info = {.struct_size = sizeof info};
    nerf_counters counters = {.struct_size = sizeof counters};
    nerf_camera camera = {.struct_size = sizeof camera, .width = 32, .height = 32, .fx = 40, .fy = 40,
        .cx = 16, .cy = 16, .c2w = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4}};
    nerf_target target = {.struct_size = sizeof target, .rgb = {.data = picture, .format = NERF_FORMAT_RGBA_F32}};
    const float position[3] = {0, 0, 0}, dir[3] = {0, 0, -1};
    float sigma, rgb[3];
    const float random = 0.5f;
    nerf_frame frame = {.struct_size = sizeof frame, .target = &target};
    nerf_points points = {.struct_size = sizeof points, .count = 1, .positions.data = position, .dirs.data = dir,
        .sigma = {.data = &sigma, .format = NERF_FORMAT_F32}, .rgb = {.data = rgb, .format = NERF_FORMAT_RGB_F32}};
    nerf_rays rays = {.struct_size = sizeof rays, .count = 1, .origins.data = position, .dirs.data = dir,
        .target = &target};
    nerf_instance instances[2] = {{.struct_size = sizeof instances[0]}, {.struct_size = sizeof instances[1]}};
    int good = 1;
    allocations = 0;
    good &= nerf_scene_memory(blob, length, NULL, &size, &align, message, sizeof message) == NERF_STATUS_OK;
    good &= nerf_scene_open(blob, length, NULL, memory, sizeof memory, &scene, message, sizeof message) == NERF_STATUS_OK;
    good &= nerf_scene_describe(scene, &info) == NERF_STATUS_OK;
    const int picture_blob = info.kind == NERF_KIND_PICTURE;
    nerf_request one = {.struct_size = sizeof one, .scene = scene, .outputs = NERF_OUTPUT_RGB};
    nerf_request two = {.struct_size = sizeof two, .instances = instances, .instance_count = 2,
        .outputs = NERF_OUTPUT_RGB};
    good &= nerf_worker_size(&one, &size, &align, message, sizeof message) == NERF_STATUS_OK;
    good &= nerf_worker_open(&one, workspace, sizeof workspace, &worker, message, sizeof message) == NERF_STATUS_OK;
    if (picture_blob) {
        frame.width = frame.height = 32;
        good &= nerf_render_picture(worker, &frame, &counters, message, sizeof message) == NERF_STATUS_OK;
    } else {
        frame.camera = &camera;
        instances[0].scene = instances[1].scene = scene;
        good &= nerf_render(worker, &frame, &counters, message, sizeof message) == NERF_STATUS_OK;
        good &= nerf_query(worker, &points, &counters, message, sizeof message) == NERF_STATUS_OK;
        good &= nerf_render_rays(worker, &rays, &counters, message, sizeof message) == NERF_STATUS_OK;
        rays.random.data = &random;
        good &= nerf_sample_rays(worker, &rays, &counters, message, sizeof message) == NERF_STATUS_OK;
        good &= nerf_explain(worker, &counters, text, sizeof text, &size, message, sizeof message) == NERF_STATUS_OK;
        good &= nerf_worker_size(&two, &size, &align, message, sizeof message) == NERF_STATUS_OK;
        good &= nerf_worker_open(&two, workspace, sizeof workspace, &worker, message, sizeof message) == NERF_STATUS_OK;
        good &= nerf_render(worker, &frame, &counters, message, sizeof message) == NERF_STATUS_OK;
    }
    /* Failures do not allocate either. */
    good &= nerf_scene_open(blob, length - 1, NULL, memory, 64, &scene, message, sizeof message) == NERF_STATUS_BLOB_TRUNCATED;
    if (picture_blob) {
        good &= nerf_render(worker, &frame, &counters, message, sizeof message) == NERF_STATUS_NOT_A_SCENE;
    } else {
        good &= nerf_render_picture(worker, &frame, &counters, message, sizeof message) == NERF_STATUS_NOT_A_PICTURE;
    }
    good &= nerf_worker_open(&one, workspace, 64, &worker, message, sizeof message) == NERF_STATUS_MEMORY;
    long counted = allocations;
    /* The wrapping works: this one counts. */
    void *volatile byte = malloc(1);
    good &= allocations == counted + 1;
    free(byte);
    printf("%ld allocations, statuses %s\n", counted, good ? "as expected" : "WRONG");
    return counted == 0 && good ? EXIT_SUCCESS : EXIT_FAILURE;
}
