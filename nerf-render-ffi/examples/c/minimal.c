#include "nerf_render.h"
#include <stdio.h>
#include <stdlib.h>

int main(void) {
    static unsigned char blob[1 << 22], picture[64 * 64 * 3];
    size_t length = fread(blob, 1, sizeof blob, stdin), size, align, work;
    const nerf_scene *scene;
    nerf_camera camera = {.struct_size = sizeof camera, .width = 64, .height = 64, .fx = 80, .fy = 80,
        .cx = 32, .cy = 32, .c2w = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4}};
    nerf_target target = {.struct_size = sizeof target, .rgb = {.data = picture, .format = NERF_FORMAT_RGB_U8}};
    if (nerf_scene_memory(blob, length, NULL, &size, &align, NULL, 0)) return 1;
    if (nerf_scene_open(blob, length, NULL, aligned_alloc(align, size), size, &scene, NULL, 0)) return 1;
    if (nerf_workspace_size(scene, NULL, NERF_OUTPUT_RGB, &work, &align, NULL, 0)) return 1;
    if (nerf_render(scene, &camera, NULL, NULL, &target, aligned_alloc(align, work), work,
                    NULL, NULL, NULL, NULL, 0)) return 1;
    printf("P6 64 64 255\n");
    return fwrite(picture, sizeof picture, 1, stdout) == 1 ? 0 : 1;
}
