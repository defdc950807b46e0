// A small path tracer with a field: photons collide with the field or fly through, so that the field lights the floor
// and casts soft shadows, with only one random number per ray.
//
//     path scene.nerf out_prefix [width height [samples]]
#include "world.hpp"

#include <random>

namespace {

using namespace world;

constexpr int bounces = 3;

// A photon, traced backwards from the eye.
struct Path {
    vec3 origin, dir, light;
    float t_max, random;
    std::uint32_t x;
    vec3 colour; // of the field where it collides
    float hit;
};

struct Tracer {
    nerf::worker worker;
    std::mt19937 generator;
    double in_field = 0.0;
    std::vector<Path> wave, next, shadows;

    float number() { return static_cast<float>(generator() >> 8) / 16777216.0f; }

    // Samples where the photons of a wave collide with the field, if anywhere.
    void collide(std::vector<Path> &paths) {
        const Stopwatch watch;
        for (Path &path : paths) {
            path.random = number();
        }
        const nerf::rays rays{nerf::member(paths, &Path::origin), nerf::member(paths, &Path::dir), {},
                              nerf::member(paths, &Path::t_max), nerf::member(paths, &Path::random)};
        nerf::target target;
        target.rgb = nerf::plane::member(paths, &Path::colour); // linear radiance of the field there
        target.opacity = nerf::plane::member(paths, &Path::hit);
        expect(worker.sample_rays(rays, target));
        in_field += watch.seconds();
    }

    // Samples a direction up from the floor, weighted by the cosine.
    vec3 scattered() {
        const float turn = 6.2831853f * number(), u = number(), r = std::sqrt(u);
        return {r * std::cos(turn), r * std::sin(turn), std::sqrt(1.0f - u)};
    }

    void trace(vec3 *row) {
        for (int bounce = 0; bounce < bounces && !wave.empty(); ++bounce) {
            for (Path &path : wave) {
                path.t_max = floor_distance(path.origin, path.dir);
            }
            collide(wave);
            for (const Path &path : wave) {
                if (path.hit > 0.0f) {
                    row[path.x] = row[path.x] + times(path.light, path.colour);
                } else if (path.t_max == infinity) {
                    row[path.x] = row[path.x] + times(path.light, sky(path.dir));
                } else {
                    const vec3 p = path.origin + path.t_max * path.dir, light = times(path.light, floor_colour(p));
                    next.push_back({p, scattered(), light, 0.0f, 0.0f, path.x, {}, 0.0f});
                    shadows.push_back({p, to_sun, to_sun.z * times(light, sun), infinity, 0.0f, path.x, {}, 0.0f});
                }
            }
            collide(shadows);
            for (const Path &shadow : shadows) {
                row[shadow.x] = row[shadow.x] + (1.0f - shadow.hit) * shadow.light;
            }
            shadows.clear();
            wave.swap(next);
            next.clear();
        }
    }
};

} // namespace

int main(int argc, char **argv) {
    const Arguments arguments(argc, argv, "samples", 64);
    const nerf::scene scene = expect(nerf::scene::open_file(arguments.scene));
    nerf::options linear;
    linear.effects.linear = 1;
    linear.background_set = 1; // black: what flies through sees the floor or the sky
    std::vector<Tracer> tracers;
    for (unsigned i = 0; i < 2; ++i) {
        tracers.push_back({expect(scene.worker(NERF_OUTPUT_RGB | NERF_OUTPUT_OPACITY, linear)), {}, 0.0, {}, {}, {}});
    }
    const nerf::camera camera = view(arguments.width, arguments.height);
    Film film(arguments.width, arguments.height);
    const Stopwatch watch;
    in_rows(film.height, tracers, [&](std::uint32_t y, Tracer &tracer) {
        tracer.generator.seed(y); // a row's own, whichever thread draws it
        vec3 *const row = &film.pixels[std::size_t{y} * film.width];
        for (int sample = 0; sample < arguments.last; ++sample) {
            tracer.wave.clear();
            for (std::uint32_t x = 0; x < film.width; ++x) {
                const float right = static_cast<float>(x) + tracer.number(), down = static_cast<float>(y) + tracer.number();
                tracer.wave.push_back({camera.centre(), direction(camera, right, down), {1.0f, 1.0f, 1.0f}, 0.0f, 0.0f, x, {}, 0.0f});
            }
            tracer.trace(row);
        }
        for (std::uint32_t x = 0; x < film.width; ++x) {
            row[x] = 1.0f / static_cast<float>(arguments.last) * row[x];
        }
    });
    const double all = watch.seconds(), in_field = 0.5 * (tracers[0].in_field + tracers[1].in_field);
    std::printf("%ux%u, %d samples a pixel in %.2f s on 2 threads, %.0f %% of it in the field\n", film.width, film.height,
                arguments.last, all, 100.0 * in_field / all);
    return film.save(arguments.prefix) ? EXIT_SUCCESS : EXIT_FAILURE;
}
