/*
 * Renders one view of a scene, or a picture.
 *
 *     render scene.nerf out_prefix [width height]
 *
 * Of a scene it writes out_prefix.ppm (8-bit RGB), out_prefix.pfm (float z_depth, world units) and
 * out_prefix.pgm (8-bit z_depth, white = near), 200x200 unless told otherwise. The camera looks at the
 * middle of the scene box from half way between near and far. Of a picture (a 2D field) it writes
 * out_prefix.ppm, in the picture's own size unless told otherwise.
 */
#include "nerf_render.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MESSAGE = 256, LARGEST_SIDE = 16384 };

static int fail(const char *what, nerf_status status, const char *message) {
    fprintf(stderr, "render: %s: %s", what, nerf_status_text(status));
    if (message[0] != '\0') {
        fprintf(stderr, "\n  %s", message);
    }
    fputc('\n', stderr);
    return EXIT_FAILURE;
}

/* Reads a whole file; NULL on any error. */
static unsigned char *read_file(const char *path, size_t *size) {
    FILE *file = fopen(path, "rb");
    unsigned char *bytes = NULL;
    long length = -1;
    if (file == NULL) {
        return NULL;
    }
    if (fseek(file, 0, SEEK_END) == 0 && (length = ftell(file)) > 0 && fseek(file, 0, SEEK_SET) == 0) {
        *size = (size_t)length;
        bytes = malloc(*size);
    }
    if (bytes != NULL && fread(bytes, 1, *size, file) != *size) {
        free(bytes);
        bytes = NULL;
    }
    fclose(file);
    return bytes;
}

/* Writes "header" and then the bytes to prefix + suffix; 0 on success. */
static int write_file(const char *prefix, const char *suffix, const char *header, const void *bytes, size_t size) {
    char path[4096];
    int length = snprintf(path, sizeof path, "%s%s", prefix, suffix);
    FILE *file = length > 0 && (size_t)length < sizeof path ? fopen(path, "wb") : NULL;
    int good = file != NULL && fputs(header, file) >= 0 && fwrite(bytes, 1, size, file) == size;
    if (file != NULL && fclose(file) != 0) {
        good = 0;
    }
    if (!good) {
        fprintf(stderr, "render: cannot write %s%s\n", prefix, suffix);
    }
    return good ? 0 : -1;
}

/* A camera where the photographs were taken; where the scene does not say, half way between near and far. */
static nerf_camera start(const nerf_scene_info *info, uint32_t width, uint32_t height) {
    const float radius = 0.5f * (info->near_distance + info->far_distance);
    const float azimuth = 0.6f, elevation = 0.4f;
    const float ca = cosf(azimuth), sa = sinf(azimuth), ce = cosf(elevation), se = sinf(elevation);
    const float backward[3] = {sa * ce, se, ca * ce};
    const float right[3] = {ca, 0.0f, -sa};
    const float up[3] = {-sa * se, ce, -ca * se};
    nerf_camera camera;
    memset(&camera, 0, sizeof camera);
    camera.struct_size = sizeof camera;
    camera.width = width;
    camera.height = height;
    camera.fx = camera.fy = 1.2f * (float)(width > height ? width : height);
    camera.cx = 0.5f * (float)width;
    camera.cy = 0.5f * (float)height;
    for (int i = 0; i < 3; ++i) {
        float *row = camera.c2w + 4 * i;
        row[0] = right[i];
        row[1] = up[i];
        row[2] = backward[i];
        row[3] = 0.5f * (info->box_min[i] + info->box_max[i]) + radius * backward[i];
    }
    if (info->up[0] != 0.0f || info->up[1] != 0.0f || info->up[2] != 0.0f) {
        nerf_camera_look_at(&camera, info->eye, info->target, info->up, NULL, 0);
    }
    return camera;
}

static int32_t show_progress(void *user, uint64_t done, uint64_t all) {
    unsigned *percent = user;
    unsigned now = all == 0 ? 100u : (unsigned)(100u * done / all);
    if (now != *percent) {
        *percent = now;
        fprintf(stderr, "\rrendering %3u %%", now);
    }
    return 0; /* anything else cancels */
}

/* Opens a worker in memory of its own, which is to be freed; NULL on any error, which it says. */
static void *open_worker(const nerf_scene *scene, uint32_t outputs, nerf_worker **worker) {
    char message[MESSAGE];
    nerf_request request;
    memset(&request, 0, sizeof request); /* no options: the defaults */
    request.struct_size = sizeof request;
    request.scene = scene;
    request.outputs = outputs;
    size_t size, align;
    nerf_status status = nerf_worker_size(&request, &size, &align, message, MESSAGE);
    if (status != NERF_STATUS_OK) {
        fail("worker", status, message);
        return NULL;
    }
    void *memory = aligned_alloc(align, size);
    status = nerf_worker_open(&request, memory, size, worker, message, MESSAGE);
    if (status != NERF_STATUS_OK) {
        fail("worker", status, message);
        free(memory);
        return NULL;
    }
    return memory;
}

/* One view of a scene: colour and z_depth. */
static int render_scene(const nerf_scene *scene, const nerf_scene_info *info, uint32_t width, uint32_t height,
                        const char *prefix) {
    char message[MESSAGE];
    /* Colour from the top row down; distance from the bottom row up, as PFM has it. */
    const size_t columns = width, rows = height, pixels = columns * rows;
    unsigned char *rgb = malloc(3 * pixels), *grey = malloc(pixels);
    float *z_depth = malloc(pixels * sizeof *z_depth);
    if (rgb == NULL || grey == NULL || z_depth == NULL) {
        fprintf(stderr, "render: out of memory\n");
        return EXIT_FAILURE;
    }
    const size_t row_bytes = columns * sizeof *z_depth;
    nerf_target target;
    memset(&target, 0, sizeof target);
    target.struct_size = sizeof target;
    target.rgb.data = rgb;
    target.rgb.format = NERF_FORMAT_RGB_U8;
    target.z_depth.data = z_depth + (rows - 1) * columns;
    target.z_depth.row_stride = -(ptrdiff_t)row_bytes;
    target.z_depth.format = NERF_FORMAT_F32;

    nerf_worker *worker;
    void *memory = open_worker(scene, NERF_OUTPUT_RGB | NERF_OUTPUT_Z_DEPTH, &worker);
    if (memory == NULL) {
        return EXIT_FAILURE;
    }
    const nerf_camera camera = start(info, width, height);
    nerf_counters counters;
    counters.struct_size = sizeof counters;
    unsigned percent = 101;
    nerf_frame frame;
    memset(&frame, 0, sizeof frame);
    frame.struct_size = sizeof frame;
    frame.camera = &camera;
    frame.target = &target;
    frame.progress = show_progress;
    frame.user = &percent;
    const nerf_status status = nerf_render(worker, &frame, &counters, message, MESSAGE);
    fputc('\n', stderr);
    if (status != NERF_STATUS_OK) {
        return fail("render", status, message);
    }

    printf("c2w");
    for (int i = 0; i < 12; ++i) {
        printf(" %.9g", (double)camera.c2w[i]);
    }
    printf("\n%llu rays, %llu samples, %llu multiply-adds\n", (unsigned long long)counters.rays,
           (unsigned long long)counters.samples_kept, (unsigned long long)counters.macs);

    const float near = info->near_distance, far = info->far_distance;
    for (size_t i = 0; i < pixels; ++i) {
        float brightness = (far - z_depth[(rows - 1 - i / columns) * columns + i % columns]) / (far - near);
        brightness = brightness > 0.0f ? (brightness < 1.0f ? brightness : 1.0f) : 0.0f;
        grey[i] = (unsigned char)(255.0f * brightness + 0.5f);
    }
    const uint16_t one = 1;
    const int little = *(const unsigned char *)&one == 1;
    char header[64];
    int bad = 0;
    snprintf(header, sizeof header, "P6\n%u %u\n255\n", (unsigned)width, (unsigned)height);
    bad |= write_file(prefix, ".ppm", header, rgb, 3 * pixels);
    snprintf(header, sizeof header, "Pf\n%u %u\n%s\n", (unsigned)width, (unsigned)height, little ? "-1.0" : "1.0");
    bad |= write_file(prefix, ".pfm", header, z_depth, pixels * sizeof *z_depth);
    snprintf(header, sizeof header, "P5\n%u %u\n255\n", (unsigned)width, (unsigned)height);
    bad |= write_file(prefix, ".pgm", header, grey, pixels);

    free(memory); /* the worker ends here */
    free(z_depth);
    free(grey);
    free(rgb);
    return bad ? EXIT_FAILURE : EXIT_SUCCESS;
}

/* A picture: colour alone, at any size, and no camera. */
static int render_picture(const nerf_scene *scene, uint32_t width, uint32_t height, const char *prefix) {
    char message[MESSAGE];
    const size_t bytes = (size_t)3 * width * height;
    unsigned char *rgb = malloc(bytes);
    if (rgb == NULL) {
        fprintf(stderr, "render: out of memory\n");
        return EXIT_FAILURE;
    }
    nerf_target target;
    memset(&target, 0, sizeof target);
    target.struct_size = sizeof target;
    target.rgb.data = rgb;
    target.rgb.format = NERF_FORMAT_RGB_U8;

    nerf_worker *worker;
    void *memory = open_worker(scene, NERF_OUTPUT_RGB, &worker);
    if (memory == NULL) {
        return EXIT_FAILURE;
    }
    nerf_counters counters;
    counters.struct_size = sizeof counters;
    unsigned percent = 101;
    nerf_frame frame;
    memset(&frame, 0, sizeof frame);
    frame.struct_size = sizeof frame;
    frame.target = &target;
    frame.width = width;
    frame.height = height;
    frame.progress = show_progress;
    frame.user = &percent;
    const nerf_status status = nerf_render_picture(worker, &frame, &counters, message, MESSAGE);
    fputc('\n', stderr);
    if (status != NERF_STATUS_OK) {
        return fail("render", status, message);
    }
    printf("%llu pixels, %llu multiply-adds\n", (unsigned long long)counters.colour_evaluations,
           (unsigned long long)counters.macs);

    char header[64];
    snprintf(header, sizeof header, "P6\n%u %u\n255\n", (unsigned)width, (unsigned)height);
    const int bad = write_file(prefix, ".ppm", header, rgb, bytes);
    free(memory);
    free(rgb);
    return bad ? EXIT_FAILURE : EXIT_SUCCESS;
}

int main(int argc, char **argv) {
    long width = 0, height = 0; /* 0: not said */
    if (argc == 5) {
        width = strtol(argv[3], NULL, 10);
        height = strtol(argv[4], NULL, 10);
    }
    if ((argc != 3 && argc != 5) || (argc == 5 && (width < 1 || height < 1)) ||
        width > LARGEST_SIDE || height > LARGEST_SIDE) {
        fprintf(stderr, "usage: %s scene.nerf out_prefix [width height]   (sizes: 1 to %d)\n", argv[0], LARGEST_SIDE);
        return EXIT_FAILURE;
    }
    if (nerf_abi_version() != NERF_ABI_VERSION) {
        fprintf(stderr, "render: library %s has another ABI than this program\n", nerf_version_text());
        return EXIT_FAILURE;
    }

    size_t blob_size = 0;
    unsigned char *blob = read_file(argv[1], &blob_size);
    if (blob == NULL) {
        fprintf(stderr, "render: cannot read %s\n", argv[1]);
        return EXIT_FAILURE;
    }

    /* Open the scene in our memory: it borrows the blob and is just let go of. */
    char message[MESSAGE];
    size_t memory_size, align;
    nerf_status status = nerf_scene_memory(blob, blob_size, NULL, &memory_size, &align, message, MESSAGE);
    if (status != NERF_STATUS_OK) {
        return fail(argv[1], status, message);
    }
    void *memory = aligned_alloc(align, memory_size);
    const nerf_scene *scene;
    status = nerf_scene_open(blob, blob_size, NULL, memory, memory_size, &scene, message, MESSAGE);
    if (status != NERF_STATUS_OK) {
        return fail(argv[1], status, message);
    }
    nerf_scene_info info;
    info.struct_size = sizeof info;
    status = nerf_scene_describe(scene, &info);
    if (status != NERF_STATUS_OK) {
        return fail(argv[1], status, "");
    }
    printf("scene %.*s, %llu parameters, kernel %u\n", (int)info.data.length, info.data.data,
           (unsigned long long)info.parameters, (unsigned)info.kernel);

    int result;
    if (info.kind == NERF_KIND_PICTURE) {
        const uint32_t columns = width == 0 ? info.picture_width : (uint32_t)width;
        const uint32_t rows = height == 0 ? info.picture_height : (uint32_t)height;
        if (columns > LARGEST_SIDE || rows > LARGEST_SIDE) {
            fprintf(stderr, "render: %s is large: say a width and height\n", argv[1]);
            return EXIT_FAILURE;
        }
        result = render_picture(scene, columns, rows, argv[2]);
    } else {
        const uint32_t columns = width == 0 ? 200 : (uint32_t)width, rows = height == 0 ? 200 : (uint32_t)height;
        result = render_scene(scene, &info, columns, rows, argv[2]);
    }
    free(memory); /* the scene ends here, */
    free(blob);   /* before its blob */
    return result;
}
