/* Draws a radiance field on a microcontroller through the C library, and says what that took: the same picture,
 * checksums and lines as src/main.rs. The scene lies in flash; the scene's handle, the worker and two rows of
 * pixels are all there is in RAM but the stack. */
#include "nerf_render.h"
#include <stdbool.h>

enum { SIDE = 32 };

/* scene.S */
extern const unsigned char scene_begin[], scene_end[];
extern uint32_t stack_bottom[], stack_top[];

static _Alignas(64) unsigned char memory[2112], work[2624];
static float rgb[SIDE][3], z_depth[SIDE], opacity[SIDE];

/* Text to the debugger's console (semihosting). */
static void write0(const char *text) {
    register int operation __asm__("r0") = 0x04;
    register const char *argument __asm__("r1") = text;
    __asm__ volatile("bkpt 0xab" : "+r"(operation) : "r"(argument) : "memory");
}

_Noreturn static void leave(bool well) {
    register int operation __asm__("r0") = 0x18;
    register int reason __asm__("r1") = well ? 0x20026 : 0x20023;
    __asm__ volatile("bkpt 0xab" : "+r"(operation) : "r"(reason) : "memory");
    for (;;) {
    }
}

static void say(const char *name, uint32_t value, uint32_t base) {
    char digits[12], *at = digits + sizeof digits;
    int width = 0;
    *--at = 0, *--at = '\n';
    do {
        *--at = "0123456789abcdef"[value % base];
        value /= base;
    } while (++width < 8 && (value || base == 16));
    write0(name), write0(" "), write0(at);
}

/* CRC-32 (ISO-HDLC) of the bits of floats. */
static uint32_t checksum(uint32_t sum, const float *values, int count) {
    for (int i = 0; i < count; ++i) {
        union {
            float value;
            uint32_t bits;
        } word = {values[i]};
        sum ^= word.bits;
        for (int bit = 0; bit < 32; ++bit) sum = sum >> 1 ^ (sum & 1 ? 0xedb88320 : 0);
    }
    return sum;
}

static char shade(float value) {
    static const char ramp[] = " .:-=+*#%@";
    int step = value > 0 ? (int)(value * 10) : 0;
    return ramp[step < 9 ? step : 9];
}

static void check(nerf_status status) {
    if (status == 0) return;
    write0("error: "), write0(nerf_status_text(status)), write0("\n");
    leave(false);
}

int main(void) {
    const size_t length = (size_t)(scene_end - scene_begin);
    const nerf_scene *scene;
    nerf_open_options open = {.struct_size = sizeof open, .kernel = NERF_KERNEL_PORTABLE};
    check(nerf_scene_open(scene_begin, length, &open, memory, sizeof memory, &scene, NULL, 0));
    /* The view of src/picture.rs. */
    nerf_camera camera = {.struct_size = sizeof camera, .width = SIDE, .height = SIDE, .fx = 1.3f * SIDE,
        .fy = 1.3f * SIDE, .cx = SIDE / 2, .cy = SIDE / 2,
        .c2w = {0.661622f, -0.315121f, 0.680408f, 2.176f,
                0.749838f, 0.278048f, -0.60036f, -1.92f,
                0.0f, 0.907407f, 0.420252f, 1.344f}};
    nerf_render_options options = {.struct_size = sizeof options, .batch_rays = 1, .batch_samples = 1};
    const nerf_request request = {.struct_size = sizeof request, .scene = scene, .options = &options,
        .outputs = NERF_OUTPUT_RGB | NERF_OUTPUT_OPACITY | NERF_OUTPUT_Z_DEPTH};
    nerf_worker *worker;
    check(nerf_worker_open(&request, work, sizeof work, &worker, NULL, 0));
    nerf_target target = {.struct_size = sizeof target,
        .rgb = {.data = rgb, .format = NERF_FORMAT_RGB_F32},
        .opacity = {.data = opacity, .format = NERF_FORMAT_F32},
        .z_depth = {.data = z_depth, .format = NERF_FORMAT_F32}};
    uint32_t colour = ~0u, depth = ~0u;
    for (uint32_t y = 0; y < SIDE; ++y) {
#ifdef NERF_RAYS /* the same picture by rays of the program's own */
        static struct { float origin[3], dir[3]; } rays[SIDE];
        float axis[3];
        check(nerf_camera_ray(&camera, camera.cx, camera.cy, rays[0].origin, axis, NULL, NULL, 0));
        for (int x = 0; x < SIDE; ++x)
            check(nerf_camera_ray(&camera, (float)x + 0.5f, (float)y + 0.5f, rays[x].origin, rays[x].dir, NULL, NULL, 0));
        const nerf_rays row = {.struct_size = sizeof row, .count = SIDE, .origins = {rays[0].origin, sizeof rays[0]},
            .dirs = {rays[0].dir, sizeof rays[0]}, .axis = axis, .target = &target};
        check(nerf_render_rays(worker, &row, NULL, NULL, 0));
#else
        const nerf_rect row = {.x = 0, .y = y, .width = SIDE, .height = 1};
        const nerf_frame frame = {.struct_size = sizeof frame, .camera = &camera, .rect = &row, .target = &target};
        check(nerf_render(worker, &frame, NULL, NULL, 0));
#endif
        colour = checksum(colour, rgb[0], 3 * SIDE);
        depth = checksum(depth, z_depth, SIDE);
        char text[2 * SIDE + 4];
        for (int x = 0; x < SIDE; ++x) {
            text[x] = shade(0.3f * rgb[x][0] + 0.6f * rgb[x][1] + 0.1f * rgb[x][2]);
            text[SIDE + 2 + x] = shade(opacity[x] > 0.5f ? 1.45f - 0.25f * z_depth[x] : 0);
        }
        text[SIDE] = text[SIDE + 1] = ' ', text[2 * SIDE + 2] = '\n', text[2 * SIDE + 3] = 0;
        write0(text);
    }
    say("colour", ~colour, 16);
    say("depth", ~depth, 16);
    const uint32_t *used = stack_bottom;
    while (*used == 0xcccccccc) ++used;
    say("stack", (uint32_t)((const char *)stack_top - (const char *)used), 10);
    leave(true);
}
