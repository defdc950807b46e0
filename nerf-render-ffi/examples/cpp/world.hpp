// Code that the five renderers beside this file share: vectors, a film, threads, a floor under a sky. Nothing here
// depends on fields; z is up.
#ifndef WORLD_HPP
#define WORLD_HPP

#include "image_files.hpp"
#include "nerf_render.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace world {

using nerf::vec3;

constexpr float infinity = std::numeric_limits<float>::infinity();

inline vec3 times(vec3 a, vec3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
inline vec3 normalised(vec3 a) { return 1.0f / std::sqrt(dot(a, a)) * a; }
inline vec3 mirrored(vec3 dir, vec3 normal) { return dir - 2.0f * dot(dir, normal) * normal; }
inline vec3 between(vec3 a, vec3 b, float u) { return (1.0f - u) * a + u * b; }

/// Direction to the sun, and linear radiance of sun and sky.
const vec3 to_sun = normalised({0.25f, 0.75f, 0.62f});
const vec3 sun{1.25f, 1.15f, 1.0f};
inline vec3 sky(vec3 dir) { return between({0.55f, 0.6f, 0.66f}, {0.14f, 0.25f, 0.5f}, std::max(0.0f, dir.z)); }

/// Height of a chequered floor.
constexpr float floor_height = -0.62f;
inline float floor_distance(vec3 origin, vec3 dir) {
    const float t = (floor_height - origin.z) / dir.z;
    return t > 1e-4f && std::fabs(t * dir.x + origin.x) < 30.0f && std::fabs(t * dir.y + origin.y) < 30.0f ? t : infinity;
}
inline vec3 floor_colour(vec3 p) {
    const int tile = static_cast<int>(std::floor(p.x / 0.6f)) + static_cast<int>(std::floor(p.y / 0.6f));
    return tile % 2 == 0 ? vec3{0.55f, 0.53f, 0.5f} : vec3{0.2f, 0.22f, 0.25f};
}

/// Linear radiance of an image's pixels, r, g, b.
struct Film {
    Film(std::uint32_t columns, std::uint32_t rows) : width(columns), height(rows), pixels(std::size_t{columns} * rows) {}

    std::uint32_t width, height;
    std::vector<vec3> pixels;

    /// Writes prefix.pfm (linear) and prefix.png (sRGB).
    bool save(const std::string &prefix) const {
        std::vector<std::uint8_t> bytes;
        std::vector<float> linear;
        for (const vec3 &pixel : pixels) {
            for (const float c : {pixel.x, pixel.y, pixel.z}) {
                const float x = std::clamp(c, 0.0f, 1.0f);
                const float encoded = x <= 0.0031308f ? 12.92f * x : 1.055f * std::pow(x, 1.0f / 2.4f) - 0.055f;
                bytes.push_back(static_cast<std::uint8_t>(255.0f * encoded + 0.5f));
                linear.push_back(c);
            }
        }
        return image_files::write(prefix + ".png", image_files::png_rgb8(width, height, bytes)) &&
               image_files::write(prefix + ".pfm", image_files::pfm(width, height, linear));
    }
};

/// Camera of the examples.
inline nerf::camera view(std::uint32_t width, std::uint32_t height) {
    auto camera = nerf::camera::from_vertical_fov(width, height, 0.6f);
    return camera.look_at({3.6f, -3.3f, 1.9f}, {0.25f, 0.2f, -0.15f});
}
inline vec3 direction(const nerf::camera &camera, float x, float y) {
    return normalised((x - camera.cx) / camera.fx * camera.right() - (y - camera.cy) / camera.fy * camera.up() -
                      camera.backward());
}

/// Calls work(row, state) for each row, on one thread for each item of `states`, with the thread's own item.
template <class State, class F>
void in_rows(std::uint32_t rows, std::vector<State> &states, F &&work) {
    std::atomic<std::uint32_t> next{0};
    std::vector<std::thread> threads;
    for (State &state : states) {
        threads.emplace_back([&next, &state, &work, rows] {
            for (std::uint32_t row = next++; row < rows; row = next++) {
                work(row, state);
            }
        });
    }
    for (std::thread &thread : threads) {
        thread.join();
    }
}

class Stopwatch {
public:
    double seconds() const { return std::chrono::duration<double>(clock::now() - begun_).count(); }

private:
    using clock = std::chrono::steady_clock;
    clock::time_point begun_ = clock::now();
};

/// Arguments of a program: `scene.nerf prefix [width height [last]]`.
struct Arguments {
    const char *scene, *prefix;
    std::uint32_t width = 640, height = 480;
    int last; // threads or samples

    Arguments(int argc, char **argv, const char *name_of_last, int otherwise) : last(otherwise) {
        if (argc < 3 || argc == 4 || argc > 6) {
            std::fprintf(stderr, "usage: %s scene.nerf out_prefix [width height [%s]]\n", argv[0], name_of_last);
            std::exit(EXIT_FAILURE);
        }
        scene = argv[1];
        prefix = argv[2];
        const auto number = [&](int i) { return std::clamp(std::atoi(argv[i]), 1, 8192); };
        if (argc > 4) {
            width = static_cast<std::uint32_t>(number(3));
            height = static_cast<std::uint32_t>(number(4));
        }
        if (argc > 5) {
            last = number(5);
        }
    }
};

/// Returns the value of a result, or ends the program on an error.
template <class T>
T expect(nerf::result<T> &&result) {
    if (!result) {
        std::fprintf(stderr, "%s\n", result.error().text());
        std::exit(EXIT_FAILURE);
    }
    return *std::move(result);
}

} // namespace world

#endif // WORLD_HPP
