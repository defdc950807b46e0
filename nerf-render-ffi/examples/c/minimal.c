#include "nerf_render.h"
#include <stdio.h>
#include <stdlib.h>

int main(void) {
    static unsigned char blob[1 << 22], picture[64 * 64 * 3];
    size_t length = fread(blob, 1, sizeof blob, stdin), size, align;
    const nerf_scene *scene;
    nerf_worker *worker;
    nerf_camera camera = {.struct_size = sizeof camera, .width = 64, .height = 64, .fx = 80, .fy = 80,
        .cx = 32, .cy = 32, .c2w = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4}};
    nerf_target target = {.struct_size = sizeof target, .rgb = {.data = picture, .format = NERF_FORMAT_RGB_U8}};
    nerf_request request = {.struct_size = sizeof request, .outputs = NERF_OUTPUT_RGB};
    nerf_frame frame = {.struct_size = sizeof frame, .camera = &camera, .target = &target};
    if (nerf_scene_memory(blob, length, NULL, &size, &align, NULL, 0)) return 1;
    if (nerf_scene_open(blob, length, NULL, aligned_alloc(align, size), size, &scene, NULL, 0)) return 1;
    request.scene = scene;
    if (nerf_worker_size(&request, &size, &align, NULL, 0)) return 1;
    if (nerf_worker_open(&request, aligned_alloc(align, size), size, &worker, NULL, 0)) return 1;
    if (nerf_render(worker, &frame, NULL, NULL, 0)) return 1;
    printf("P6 64 64 255\n");
    return fwrite(picture, sizeof picture, 1, stdout) == 1 ? 0 : 1;
}
