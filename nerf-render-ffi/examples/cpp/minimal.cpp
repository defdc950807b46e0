#include "nerf_render.hpp"
#include <cstdio>
#include <vector>

int main(int, char **arguments) {
    auto scene = nerf::scene::open_file(arguments[1]);
    if (!scene) return std::fprintf(stderr, "%s\n", scene.error().text()), 1;
    const auto camera = scene->start_camera(400, 400, 0.7f);
    std::vector<std::uint8_t> pixels(400 * 400 * 3);
    std::vector<float> depth(400 * 400);
    nerf::target target;
    target.rgb = nerf::plane::rgb_u8(pixels);
    target.z_depth = nerf::plane::f32(depth);
    auto worker = scene->worker(target.outputs());
    if (!worker || !worker->render(camera, target)) return 1;
    std::printf("P6 400 400 255\n");
    return std::fwrite(pixels.data(), pixels.size(), 1, stdout) == 1 ? 0 : 1;
}
