// Renders one view of a scene, or a picture, on all cores: each thread renders tile after tile.
//
//     render scene.nerf out_prefix [width height [threads]]
//
// Of a scene it writes out_prefix.ppm (8-bit RGB), out_prefix.pfm (float z_depth, world units) and
// out_prefix.pgm (8-bit z_depth, white = near), 200x200 unless told otherwise. The camera looks at the
// middle of the scene box from half way between near and far. Of a picture (a 2D field) it writes
// out_prefix.ppm, in the picture's own size unless told otherwise.
#include "image_files.hpp"
#include "nerf_render.hpp"

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace {

constexpr std::uint32_t largest_side = 16384;

struct Image {
    Image(std::uint32_t w, std::uint32_t h, bool deep)
        : width(w), height(h), rgb(std::size_t{3} * w * h), z_depth(deep ? std::size_t{1} * w * h : 0) {}

    nerf::target target() {
        nerf::target to;
        to.rgb = nerf::plane::rgb_u8(rgb);
        if (!z_depth.empty()) {
            to.z_depth = nerf::plane::f32(z_depth);
        }
        return to;
    }

    std::uint32_t width, height;
    std::vector<std::uint8_t> rgb;
    std::vector<float> z_depth; // empty for a picture
};

// Renders tiles until none is left: the work of one thread, with a worker of its own.
nerf::result<void> work(const nerf::scene &scene, const nerf::camera &camera, const nerf::target &target,
                        std::atomic<std::size_t> &next) {
    nerf::result<nerf::worker> worker = scene.worker(target.outputs());
    if (!worker) {
        return worker.error();
    }
    const nerf::tiles tiles{camera.width, camera.height, 64};
    for (std::size_t i = next++; i < tiles.size(); i = next++) {
        const auto done = scene.is_picture() ? worker->render_picture(camera.width, camera.height, target, tiles[i])
                                             : worker->render(camera, target, tiles[i]);
        if (!done) {
            return done.error();
        }
    }
    return {};
}

nerf::result<void> render(const nerf::scene &scene, const nerf::camera &camera, const nerf::target &target,
                          unsigned threads) {
    std::atomic<std::size_t> next{0};
    std::mutex mutex;
    nerf::result<void> outcome;
    std::vector<std::thread> workers;
    for (unsigned i = 0; i < threads; ++i) {
        workers.emplace_back([&] {
            const nerf::result<void> done = work(scene, camera, target, next);
            if (!done) {
                const std::lock_guard<std::mutex> lock(mutex);
                outcome = done;
            }
        });
    }
    for (std::thread &worker : workers) {
        worker.join();
    }
    return outcome;
}

bool write(const std::string &path, const std::string &bytes) {
    const bool written = image_files::write(path, bytes);
    if (!written) {
        std::cerr << "render: cannot write " << path << '\n';
    }
    return written;
}

bool save(const Image &image, const nerf_scene_info &info, const std::string &prefix) {
    if (!write(prefix + ".ppm", image_files::pnm(image.width, image.height, image.rgb))) {
        return false;
    }
    if (image.z_depth.empty()) {
        return true;
    }
    std::vector<std::uint8_t> grey;
    for (const float z : image.z_depth) {
        const float brightness = (info.far_distance - z) / (info.far_distance - info.near_distance);
        grey.push_back(static_cast<std::uint8_t>(255.0f * std::clamp(brightness, 0.0f, 1.0f) + 0.5f));
    }
    return write(prefix + ".pfm", image_files::pfm(image.width, image.height, image.z_depth)) &&
           write(prefix + ".pgm", image_files::pnm(image.width, image.height, grey));
}

int fail(const std::string &what, const nerf::error &error) {
    std::cerr << "render: " << what << ": " << nerf_status_text(error.status) << "\n  " << error.message << '\n';
    return EXIT_FAILURE;
}

} // namespace

int main(int argc, char **argv) {
    const bool sized = argc > 4;
    const long width = sized ? std::strtol(argv[3], nullptr, 10) : 200;
    const long height = sized ? std::strtol(argv[4], nullptr, 10) : 200;
    const long cores = static_cast<long>(std::max(1u, std::thread::hardware_concurrency()));
    const long threads = argc > 5 ? std::strtol(argv[5], nullptr, 10) : cores;
    if (argc < 3 || argc == 4 || argc > 6 || std::min({width, height, threads}) < 1 ||
        std::max({width, height, threads}) > long{largest_side}) {
        std::cerr << "usage: " << argv[0] << " scene.nerf out_prefix [width height [threads]]   (1 to 16384)\n";
        return EXIT_FAILURE;
    }
    const auto scene = nerf::scene::open_file(argv[1]);
    if (!scene) {
        return fail(std::string("cannot read ") + argv[1], scene.error());
    }
    const nerf_scene_info &info = scene->info();
    const bool own_size = scene->is_picture() && !sized;
    if (own_size && std::max(info.picture_width, info.picture_height) > largest_side) {
        std::cerr << "render: " << argv[1] << " is large: say a width and height\n";
        return EXIT_FAILURE;
    }
    const std::uint32_t columns = own_size ? info.picture_width : static_cast<std::uint32_t>(width);
    const std::uint32_t rows = own_size ? info.picture_height : static_cast<std::uint32_t>(height);
    // A picture needs no camera pose, only a size.
    nerf::camera camera(columns, rows, 1.2f * static_cast<float>(std::max(columns, rows)));
    camera.orbit(scene->centre(), scene->orbit_radius(), scene->start_azimuth(), scene->start_elevation(), scene->up());
    Image image(columns, rows, !scene->is_picture());
    const auto done = render(*scene, camera, image.target(), static_cast<unsigned>(threads));
    if (!done) {
        return fail("render", done.error());
    }
    if (!save(image, info, argv[2])) {
        return EXIT_FAILURE;
    }
    if (!scene->is_picture()) {
        std::cout.precision(9);
        std::cout << "c2w";
        for (const float number : camera.c2w) {
            std::cout << ' ' << number;
        }
        std::cout << '\n';
    }
    return EXIT_SUCCESS;
}
