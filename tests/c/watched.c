/*
 * A host for valgrind and the sanitizers to watch.
 *
 *     watched good  scene.nerf      everything a host may do: nothing is to be reported
 *     watched leak  scene.nerf      keeps a scene it opened from a file
 *     watched short scene.nerf      lends a worker memory one line shorter than it says
 *     watched race  scene.nerf      renders the same pixels on two threads
 *
 * What is wrong on purpose shows that the watcher is there, and sees into the library.
 */
#include "nerf_render.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SIDE = 20, LINE = 64 };

static nerf_camera camera(void) {
    nerf_camera camera = {.struct_size = sizeof camera, .width = SIDE, .height = SIDE, .fx = 25, .fy = 25,
        .cx = SIDE / 2, .cy = SIDE / 2, .c2w = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4}};
    return camera;
}

static void demand(int truth, const char *what) {
    if (!truth) {
        fprintf(stderr, "watched: %s\n", what);
        exit(EXIT_FAILURE);
    }
}

/* Opens a worker in memory that is to be freed, `missing` bytes shorter than it says. */
static void *open_worker(const nerf_request *request, size_t missing, nerf_worker **worker) {
    char message[256];
    size_t size, align;
    demand(nerf_worker_size(request, &size, &align, message, sizeof message) == NERF_STATUS_OK, message);
    void *memory = aligned_alloc(align, size - missing);
    demand(nerf_worker_open(request, memory, size, worker, message, sizeof message) == NERF_STATUS_OK, message);
    return memory;
}

/* A part of a picture, rendered by a worker of its own. */
struct part {
    const nerf_scene *scene;
    nerf_rect rect;
    float *pixels; /* of the whole picture */
    size_t missing; /* bytes the worker's memory is shorter than it says */
    nerf_progress progress;
    nerf_status status;
};

static void *render(void *argument) {
    struct part *part = argument;
    nerf_worker *worker;
    const nerf_request request = {.struct_size = sizeof request, .scene = part->scene, .outputs = NERF_OUTPUT_RGB};
    void *memory = open_worker(&request, part->missing, &worker);
    const nerf_camera from = camera();
    nerf_target target = {.struct_size = sizeof target, .rgb = {
        .data = part->pixels + 3 * (SIDE * part->rect.y + part->rect.x),
        .row_stride = 3 * SIDE * sizeof(float), .format = NERF_FORMAT_RGB_F32}};
    nerf_counters counters = {.struct_size = sizeof counters};
    const nerf_frame frame = {.struct_size = sizeof frame, .camera = &from, .rect = &part->rect, .target = &target,
        .progress = part->progress};
    part->status = nerf_render(worker, &frame, &counters, NULL, 0);
    free(memory);
    return NULL;
}

/* Two threads, each its part. */
static void together(struct part *one, struct part *other) {
    pthread_t thread;
    demand(pthread_create(&thread, NULL, render, one) == 0, "no thread");
    render(other);
    demand(pthread_join(thread, NULL) == 0, "no end");
    demand(one->status == NERF_STATUS_OK && other->status == NERF_STATUS_OK, "a part failed");
}

static int32_t stop(void *user, uint64_t done, uint64_t all) {
    (void)user, (void)all;
    return done > 0;
}

/* What a worker does beside frames: words, points and rays. */
static void questions(nerf_worker *worker) {
    char message[256], *text;
    size_t length;
    demand(nerf_explain(worker, NULL, NULL, 0, &length, NULL, 0) == NERF_STATUS_OK, "no words");
    text = malloc(length);
    demand(nerf_explain(worker, NULL, text, length, NULL, NULL, 0) == NERF_STATUS_OK, "no words");
    demand(strlen(text) + 1 == length, "words of another length");
    free(text);

    /* Nothing lies behind the last of them. */
    struct asked {
        float origin[3], dir[3], random;
    } *asked = malloc(3 * sizeof *asked);
    struct answer {
        float opacity, rgb[3];
    } *answers = malloc(3 * sizeof *answers);
    float *densities = malloc(3 * sizeof *densities);
    for (int i = 0; i < 3; ++i) {
        asked[i] = (struct asked){{0.1f * (float)i, 0, 1}, {0, 0, -1}, 0.3f * (float)i};
    }
    const nerf_floats origins = {asked->origin, sizeof *asked}, dirs = {asked->dir, sizeof *asked};
    const nerf_plane opacity = {.data = &answers->opacity, .pixel_stride = sizeof *answers, .format = NERF_FORMAT_F32};
    const nerf_plane rgb = {.data = answers->rgb, .pixel_stride = sizeof *answers, .format = NERF_FORMAT_RGB_F32};
    const nerf_points points = {.struct_size = sizeof points, .count = 3, .positions = origins, .dirs = dirs,
        .sigma = {.data = densities, .format = NERF_FORMAT_F32}, .rgb = rgb};
    demand(nerf_query(worker, &points, NULL, message, sizeof message) == NERF_STATUS_OK, message);
    const nerf_target target = {.struct_size = sizeof target, .rgb = rgb, .opacity = opacity};
    nerf_rays rays = {.struct_size = sizeof rays, .count = 3, .origins = origins, .dirs = dirs, .target = &target};
    demand(nerf_render_rays(worker, &rays, NULL, message, sizeof message) == NERF_STATUS_OK, message);
    rays.random.data = &asked->random;
    rays.random.stride = sizeof *asked;
    demand(nerf_sample_rays(worker, &rays, NULL, message, sizeof message) == NERF_STATUS_OK, message);
    free(densities);
    free(answers);
    free(asked);
}

/* The rest of a host's life: questions, a lent scene, two instances of it, a cancelled frame, and refusals. */
static void everything(const char *path, const nerf_scene *scene, float *pixels) {
    char message[64];
    size_t size, align, length;
    nerf_worker *worker;
    nerf_scene_info info = {.struct_size = sizeof info};
    demand(nerf_scene_describe(scene, &info) == NERF_STATUS_OK, "no description");
    nerf_request request = {.struct_size = sizeof request, .scene = scene,
        .outputs = NERF_OUTPUT_RGB | NERF_OUTPUT_OPACITY};
    void *own = open_worker(&request, 0, &worker);
    questions(worker);
    free(own);
    struct part part = {scene, {0, 0, SIDE, SIDE}, pixels, 0, stop, NERF_STATUS_OK};
    render(&part);
    demand(part.status == NERF_STATUS_CANCELLED, "not cancelled");

    FILE *file = fopen(path, "rb");
    demand(file != NULL && fseek(file, 0, SEEK_END) == 0, "no file");
    length = (size_t)ftell(file);
    rewind(file);
    unsigned char *blob = malloc(length);
    demand(fread(blob, 1, length, file) == length, "no bytes");
    fclose(file);
    demand(nerf_scene_memory(blob, length, NULL, &size, &align, NULL, 0) == NERF_STATUS_OK, "no memory size");
    void *memory = aligned_alloc(align, size);
    const nerf_scene *lent;
    demand(nerf_scene_open(blob, length, NULL, memory, size - 1, &lent, message, sizeof message) == NERF_STATUS_MEMORY,
           "a byte less passed");
    demand(nerf_scene_open(blob, length, NULL, memory, size, &lent, message, sizeof message) == NERF_STATUS_OK,
           message);
    nerf_scene_close(lent); /* nothing to close */
    struct part whole = {lent, {0, 0, SIDE, SIDE}, pixels, 0, NULL, NERF_STATUS_OK};
    render(&whole);
    demand(whole.status == NERF_STATUS_OK, "the lent scene");
    const nerf_instance instances[2] = {
        {sizeof instances[0], scene, {0}},
        {sizeof instances[1], lent, {0, -0.5f, 0, 0.3f, 0.5f, 0, 0, 0, 0, 0, 0.5f, 0}}};
    request.scene = NULL, request.instances = instances, request.instance_count = 2;
    own = open_worker(&request, 0, &worker);
    questions(worker);
    free(own);
    free(memory);
    blob[length - 1] ^= 1;
    demand(nerf_scene_memory(blob, length, NULL, &size, &align, message, sizeof message) == NERF_STATUS_BLOB_CHECKSUM,
           "damage passed");
    free(blob);
    demand(nerf_scene_open_file("absent.nerf", NULL, &lent, message, sizeof message) == NERF_STATUS_FILE, "absent");
}

int main(int argc, char **argv) {
    demand(argc == 3, "usage: watched good|leak|short|race scene.nerf");
    const char *what = argv[1];
    char message[256];
    const nerf_scene *scene;
    demand(nerf_scene_open_file(argv[2], NULL, &scene, message, sizeof message) == NERF_STATUS_OK, message);
    float *pixels = calloc(SIDE * SIDE * 3, sizeof *pixels);
    const uint32_t half = SIDE / 2;
    struct part upper = {scene, {0, 0, SIDE, half}, pixels, 0, NULL, NERF_STATUS_OK};
    struct part lower = {scene, {0, half, SIDE, half}, pixels, 0, NULL, NERF_STATUS_OK};
    if (strcmp(what, "race") == 0) {
        /* Few pixels: the watcher remembers only so many accesses of a thread. */
        upper.rect.width = upper.rect.height = 2;
        lower = upper;
    }
    if (strcmp(what, "short") == 0) {
        upper.missing = LINE;
    }
    together(&upper, &lower);
    if (strcmp(what, "good") == 0) {
        everything(argv[2], scene, pixels);
    }
    free(pixels);
    if (strcmp(what, "leak") == 0) {
        scene = NULL;
    }
    nerf_scene_close(scene);
    return EXIT_SUCCESS;
}
