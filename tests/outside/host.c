/* A C project outside of nerf_render: 37x29 pixels of the scene on stdin, RGB bytes on stdout. */
#include <nerf_render.h>
#include <stdio.h>
#include <stdlib.h>

#define WIDTH 37
#define HEIGHT 29

static unsigned char blob[1 << 20], rgb[WIDTH * HEIGHT * 3];
static char message[256];

static int failed(nerf_status status) {
    if (status == NERF_STATUS_OK) return 0;
    fprintf(stderr, "%s: %s\n", nerf_status_text(status), message);
    return 1;
}

int main(void) {
    size_t length = fread(blob, 1, sizeof blob, stdin), size = 0, align = 0;
    const nerf_scene *scene = NULL;
    nerf_worker *worker = NULL;
    nerf_camera camera = {.struct_size = sizeof camera, .width = WIDTH, .height = HEIGHT, .fx = 44.0f, .fy = 44.0f,
        .cx = WIDTH / 2.0f, .cy = HEIGHT / 2.0f, .c2w = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4}};
    nerf_target target = {.struct_size = sizeof target, .rgb = {.data = rgb, .format = NERF_FORMAT_RGB_U8}};
    nerf_request request = {.struct_size = sizeof request, .outputs = NERF_OUTPUT_RGB};
    nerf_frame frame = {.struct_size = sizeof frame, .camera = &camera, .target = &target};
    void *memory, *workspace;
    int bad;

    if (nerf_abi_version() != NERF_ABI_VERSION) {
        fprintf(stderr, "header: ABI %d, library: ABI %u\n", NERF_ABI_VERSION, (unsigned)nerf_abi_version());
        return 1;
    }
    if (failed(nerf_scene_memory(blob, length, NULL, &size, &align, message, sizeof message))) return 1;
    memory = aligned_alloc(align, size);
    if (failed(nerf_scene_open(blob, length, NULL, memory, size, &scene, message, sizeof message))) return 1;
    request.scene = scene;
    if (failed(nerf_worker_size(&request, &size, &align, message, sizeof message))) return 1;
    workspace = aligned_alloc(align, size);
    bad = failed(nerf_worker_open(&request, workspace, size, &worker, message, sizeof message)) ||
        failed(nerf_render(worker, &frame, NULL, message, sizeof message)) ||
        fwrite(rgb, sizeof rgb, 1, stdout) != 1;
    free(workspace);
    free(memory);
    return bad;
}
