// A C++ project outside of nerf_render: 37x29 pixels of the scene on stdin, RGB bytes on stdout.
#include <nerf_render.h>
#if __has_include(<nerf_render.hpp>)
#include <nerf_render.hpp>
#endif
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <vector>

namespace {

constexpr std::uint32_t width = 37, height = 29;
std::array<char, 256> message;

struct Free {
    void operator()(void *memory) const { std::free(memory); }
};
using Memory = std::unique_ptr<void, Free>;

void check(nerf_status status) {
    if (status == NERF_STATUS_OK) return;
    std::fprintf(stderr, "%s: %s\n", nerf_status_text(status), message.data());
    std::exit(1);
}

} // namespace

int main() {
    if (nerf_abi_version() != NERF_ABI_VERSION) {
        std::fprintf(stderr, "header and library are of different ABIs\n");
        return 1;
    }
    std::vector<unsigned char> blob(1 << 20), rgb(width * height * 3);
    blob.resize(std::fread(blob.data(), 1, blob.size(), stdin));
    std::size_t size = 0, align = 0;
    check(nerf_scene_memory(blob.data(), blob.size(), nullptr, &size, &align, message.data(), message.size()));
    const Memory memory(std::aligned_alloc(align, size));
    const nerf_scene *scene = nullptr;
    check(nerf_scene_open(blob.data(), blob.size(), nullptr, memory.get(), size, &scene, message.data(),
        message.size()));

    nerf_camera camera = {};
    camera.struct_size = sizeof camera;
    camera.width = width;
    camera.height = height;
    camera.fx = camera.fy = 44.0f;
    camera.cx = width / 2.0f;
    camera.cy = height / 2.0f;
    camera.c2w[0] = camera.c2w[5] = camera.c2w[10] = 1.0f;
    camera.c2w[11] = 4.0f;
    nerf_target target = {};
    target.struct_size = sizeof target;
    target.rgb.data = rgb.data();
    target.rgb.format = NERF_FORMAT_RGB_U8;
    nerf_request request = {};
    request.struct_size = sizeof request;
    request.scene = scene;
    request.outputs = NERF_OUTPUT_RGB;
    check(nerf_worker_size(&request, &size, &align, message.data(), message.size()));
    const Memory home(std::aligned_alloc(align, size));
    nerf_worker *worker = nullptr;
    check(nerf_worker_open(&request, home.get(), size, &worker, message.data(), message.size()));
    nerf_frame frame = {};
    frame.struct_size = sizeof frame;
    frame.camera = &camera;
    frame.target = &target;
    check(nerf_render(worker, &frame, nullptr, message.data(), message.size()));
    return std::fwrite(rgb.data(), rgb.size(), 1, stdout) == 1 ? 0 : 1;
}
