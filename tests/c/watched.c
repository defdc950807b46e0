/*
 * A host for valgrind and the sanitizers to watch.
 *
 *     watched good  scene.nerf      everything a host may do: nothing is to be reported
 *     watched leak  scene.nerf      keeps a scene it opened from a file
 *     watched short scene.nerf      lends a workspace one line shorter than it says
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

/* A part of a picture, rendered in a workspace of its own. */
struct part {
    const nerf_scene *scene;
    nerf_rect rect;
    float *pixels; /* of the whole picture */
    size_t missing; /* bytes the workspace is shorter than it says */
    nerf_progress progress;
    nerf_status status;
};

static void *render(void *argument) {
    struct part *part = argument;
    size_t size, align;
    demand(nerf_workspace_size(part->scene, NULL, NERF_OUTPUT_RGB, &size, &align, NULL, 0) == NERF_STATUS_OK,
           "no workspace size");
    void *workspace = aligned_alloc(align, size - part->missing);
    const nerf_camera from = camera();
    nerf_target target = {.struct_size = sizeof target, .rgb = {
        .data = part->pixels + 3 * (SIDE * part->rect.y + part->rect.x),
        .row_stride = 3 * SIDE * sizeof(float), .format = NERF_FORMAT_RGB_F32}};
    nerf_counters counters = {.struct_size = sizeof counters};
    part->status = nerf_render(part->scene, &from, NULL, &part->rect, &target, workspace, size, part->progress, NULL,
                               &counters, NULL, 0);
    free(workspace);
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

/* The rest of a host's life: a lent scene, a query, words, a cancelled frame, and refusals. */
static void everything(const char *path, const nerf_scene *scene, float *pixels) {
    char message[64], *text;
    size_t size, align, length;
    nerf_scene_info info = {.struct_size = sizeof info};
    demand(nerf_scene_describe(scene, &info) == NERF_STATUS_OK, "no description");
    demand(nerf_explain(scene, NULL, NERF_OUTPUT_RGB, NULL, NULL, 0, &length, NULL, 0) == NERF_STATUS_OK, "no words");
    text = malloc(length);
    demand(nerf_explain(scene, NULL, NERF_OUTPUT_RGB, NULL, text, length, NULL, NULL, 0) == NERF_STATUS_OK, "no words");
    demand(strlen(text) + 1 == length, "words of another length");
    free(text);
    struct part part = {scene, {0, 0, SIDE, SIDE}, pixels, 0, stop, NERF_STATUS_OK};
    render(&part);
    demand(part.status == NERF_STATUS_CANCELLED, "not cancelled");
    const float position[3] = {0, 0, 0}, dir[3] = {0, 0, -1};
    float sigma, rgb[3];
    demand(nerf_workspace_size(scene, NULL, NERF_OUTPUT_RGB, &size, &align, NULL, 0) == NERF_STATUS_OK, "no size");
    void *workspace = aligned_alloc(align, size);
    demand(nerf_query(scene, NULL, 1, position, dir, &sigma, rgb, workspace, size, NULL, NULL, 0) == NERF_STATUS_OK,
           "no answer");
    free(workspace);

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
