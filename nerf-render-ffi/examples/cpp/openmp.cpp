// A ray tracer under OpenMP, pixel by pixel: each thread has workers of its own, and each ray is one call.
//
//     openmp scene.nerf out_prefix [width height]         (-fopenmp; OMP_NUM_THREADS says how many threads)
#include "world.hpp"

namespace {

using namespace world;

// State of one thread.
struct Tracer {
    nerf::worker colours, shadows;

    vec3 light(vec3 origin, vec3 dir) {
        const float t = floor_distance(origin, dir);
        const nerf::pixel field = expect(colours.render_ray(origin, dir, 0, t)); // linear, premultiplied
        vec3 behind = sky(dir);
        if (t < infinity && field.opacity < 1.0f) {
            const vec3 p = origin + t * dir;
            const float through = 1.0f - expect(shadows.render_ray(p, to_sun)).opacity;
            behind = times(floor_colour(p), 0.45f * sky({0.0f, 0.0f, 1.0f}) + through * to_sun.z * sun);
        }
        return field.rgb + (1.0f - field.opacity) * behind;
    }
};

} // namespace

int main(int argc, char **argv) {
    const Arguments arguments(argc, argv, "", 1);
    const nerf::scene scene = expect(nerf::scene::open_file(arguments.scene));
    nerf::options linear;
    linear.effects.linear = 1;
    const nerf::camera camera = view(arguments.width, arguments.height);
    Film film(arguments.width, arguments.height);
    const Stopwatch watch;
#pragma omp parallel
    {
        Tracer tracer{expect(scene.worker(NERF_OUTPUT_RGB, linear)), expect(scene.worker(NERF_OUTPUT_OPACITY))};
#pragma omp for schedule(dynamic)
        for (int y = 0; y < static_cast<int>(film.height); ++y) {
            for (std::uint32_t x = 0; x < film.width; ++x) {
                const vec3 dir = direction(camera, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
                film.pixels[static_cast<std::size_t>(y) * film.width + x] = tracer.light(camera.centre(), dir);
            }
        }
    }
    std::printf("%ux%u in %.2f s\n", film.width, film.height, watch.seconds());
    return film.save(arguments.prefix) ? EXIT_SUCCESS : EXIT_FAILURE;
}
