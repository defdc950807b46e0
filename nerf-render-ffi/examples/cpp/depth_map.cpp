// Renders a view of a scene as a depth map, with nothing but the standard library.
//
//     depth_map scene.nerf out_prefix [width height]
//
// Writes out_prefix.png (8-bit colour), out_prefix.pfm (float z_depth, world units; the far distance where nothing is)
// and out_prefix_z_depth.png (16-bit grey: z_depth in steps; 0 where opacity is below one half). The size of a step is
// in the file, as the text "Scale", and on stdout. World units are those of the camera poses that the scene was made
// from: metres if the poses were in metres. 400x400 unless told otherwise.
#include "image_files.hpp"
#include "nerf_render.hpp"

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

namespace {

int fail(const std::string &what) {
    std::cerr << "depth_map: " << what << '\n';
    return EXIT_FAILURE;
}

// Writes a float with enough digits to distinguish all floats.
std::string digits(float number) {
    std::ostringstream text;
    text.precision(9);
    text << number;
    return text.str();
}

} // namespace

int main(int argc, char **argv) {
    const long width = argc == 5 ? std::strtol(argv[3], nullptr, 10) : 400;
    const long height = argc == 5 ? std::strtol(argv[4], nullptr, 10) : 400;
    if ((argc != 3 && argc != 5) || width < 1 || height < 1 || width > 16384 || height > 16384) {
        std::cerr << "usage: " << argv[0] << " scene.nerf out_prefix [width height]   (1 to 16384)\n";
        return EXIT_FAILURE;
    }
    const auto scene = nerf::scene::open_file(argv[1]);
    if (!scene) {
        return fail(scene.error().text());
    }
    if (scene->is_picture()) {
        return fail(std::string(argv[1]) + ": a picture (a 2D field) has no depth");
    }

    const auto columns = static_cast<std::uint32_t>(width), rows = static_cast<std::uint32_t>(height);
    const auto camera = scene->start_camera(columns, rows, 0.7f);

    // Three planes of one frame; other outputs are not computed.
    const std::size_t pixels = std::size_t{columns} * rows;
    std::vector<std::uint8_t> rgb(3 * pixels);
    std::vector<float> opacity(pixels), z_depth(pixels);
    nerf::target target;
    target.rgb = nerf::plane::rgb_u8(rgb);
    target.opacity = nerf::plane::f32(opacity);
    target.z_depth = nerf::plane::f32(z_depth);

    // Preset without a visible loss.
    nerf::options options;
    if (const auto set = scene->preset(NERF_PRESET_HIGH, options); !set) {
        return fail(set.error().text());
    }
    auto worker = scene->worker(target.outputs(), options);
    if (!worker) {
        return fail(worker.error().text());
    }
    const auto progress = [](std::uint64_t done, std::uint64_t all) {
        std::cerr << "\r" << 100 * done / all << " %" << std::flush;
    };
    const auto counters = worker->render(camera, target, nerf::whole, progress);
    std::cerr << '\n';
    if (!counters) {
        return fail(counters.error().text());
    }

    // Scale of the 16-bit steps: 65535 is the scene's far distance, or the farthest z_depth if that is larger.
    float farthest = scene->info().far_distance;
    for (std::size_t i = 0; i < pixels; ++i) {
        farthest = std::fmax(farthest, opacity[i] < 0.5f ? 0.0f : z_depth[i]);
    }
    const float scale = farthest / 65535.0f;
    std::vector<std::uint16_t> steps(pixels);
    for (std::size_t i = 0; i < pixels; ++i) {
        const float step = std::fmin(std::round(z_depth[i] / scale), 65535.0f);
        steps[i] = opacity[i] < 0.5f ? std::uint16_t{0} : static_cast<std::uint16_t>(step);
    }
    const std::string prefix = argv[2], unit = " world units a step; 0 is nothing";
    for (const auto &[path, bytes] : {
             std::pair(prefix + ".png", image_files::png_rgb8(columns, rows, rgb)),
             std::pair(prefix + ".pfm", image_files::pfm(columns, rows, z_depth)),
             std::pair(prefix + "_z_depth.png",
                       image_files::png_grey16(columns, rows, steps, {{"Scale", digits(scale) + unit}})),
         }) {
        if (!image_files::write(path, bytes)) {
            return fail("cannot write " + path);
        }
    }
    std::cout << "scale " << digits(scale) << unit << "\nfocal " << digits(camera.fx) << "\nc2w";
    for (const float number : camera.c2w) {
        std::cout << ' ' << digits(number);
    }
    std::cout << "\nmultiply-adds " << counters->macs << '\n';
    return EXIT_SUCCESS;
}
