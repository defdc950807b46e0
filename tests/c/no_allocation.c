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

int main(void) {
    size_t length = fread(blob, 1, sizeof blob, stdin), size, align;
    char message[128];
    const nerf_scene *scene;
    nerf_scene_info info = {.struct_size = sizeof info};
    nerf_counters counters = {.struct_size = sizeof counters};
    nerf_camera camera = {.struct_size = sizeof camera, .width = 32, .height = 32, .fx = 40, .fy = 40,
        .cx = 16, .cy = 16, .c2w = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4}};
    nerf_target target = {.struct_size = sizeof target, .rgb = {.data = picture, .format = NERF_FORMAT_RGBA_F32}};
    const float position[3] = {0, 0, 0}, dir[3] = {0, 0, -1};
    float sigma, rgb[3];
    int good = 1;
    allocations = 0;
    good &= nerf_scene_memory(blob, length, NULL, &size, &align, message, sizeof message) == NERF_STATUS_OK;
    good &= nerf_scene_open(blob, length, NULL, memory, sizeof memory, &scene, message, sizeof message) == NERF_STATUS_OK;
    good &= nerf_scene_describe(scene, &info) == NERF_STATUS_OK;
    const int picture_blob = info.kind == NERF_KIND_PICTURE;
    if (picture_blob) {
        good &= nerf_picture_workspace_size(scene, NULL, &size, &align, message, sizeof message) == NERF_STATUS_OK;
        good &= nerf_render_picture(scene, 32, 32, NULL, NULL, &target, workspace, sizeof workspace, NULL, NULL,
                                    &counters, message, sizeof message) == NERF_STATUS_OK;
    } else {
        good &= nerf_workspace_size(scene, NULL, NERF_OUTPUT_RGB, &size, &align, message, sizeof message) == NERF_STATUS_OK;
        good &= nerf_render(scene, &camera, NULL, NULL, &target, workspace, sizeof workspace, NULL, NULL, &counters,
                            message, sizeof message) == NERF_STATUS_OK;
        good &= nerf_query(scene, NULL, 1, position, dir, &sigma, rgb, workspace, sizeof workspace, &counters,
                           message, sizeof message) == NERF_STATUS_OK;
    }
    /* Failures do not allocate either. */
    good &= nerf_scene_open(blob, length - 1, NULL, memory, 64, &scene, message, sizeof message) == NERF_STATUS_BLOB_TRUNCATED;
    good &= nerf_render(scene, &camera, NULL, NULL, &target, workspace, 64, NULL, NULL, &counters, message,
                        sizeof message) == (picture_blob ? NERF_STATUS_NOT_A_SCENE : NERF_STATUS_MEMORY);
    good &= nerf_render_picture(scene, 32, 32, NULL, NULL, &target, workspace, 64, NULL, NULL, &counters, message,
                                sizeof message) == (picture_blob ? NERF_STATUS_MEMORY : NERF_STATUS_NOT_A_PICTURE);
    long counted = allocations;
    /* The wrapping works: this one counts. */
    void *volatile one = malloc(1);
    good &= allocations == counted + 1;
    free(one);
    printf("%ld allocations, statuses %s\n", counted, good ? "as expected" : "WRONG");
    return counted == 0 && good ? EXIT_SUCCESS : EXIT_FAILURE;
}
