/* Two libraries in Rust, linked statically into one C program. */
#include <nerf_render.h>

int beside(void);

int main(void) {
    size_t size, align;
    nerf_status status = nerf_scene_memory("no blob", 7, NULL, &size, &align, NULL, 0);
    return beside() == 1 && status != NERF_STATUS_OK ? 0 : 1;
}
