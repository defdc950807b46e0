// A small ray tracer of Whitted's kind with two fields: a floor, a mirror, a ball of glass, and two instances of the
// scene that overlap. Surfaces and fields hide each other, also in mirrors, and fields cast shadows on the floor.
//
//     hybrid scene.nerf out_prefix [width height [threads]]
//
// Rays are traced in waves: one call renders the fields along all rays of a row.
#include "world.hpp"

namespace {

using namespace world;

constexpr int bounces = 6;
constexpr float faintest = 0.01f; // of a path's light

struct Ball {
    vec3 centre;
    float radius;
    bool glass;
};
const Ball balls[] = {{{-1.25f, 0.9f, 0.1f}, 0.72f, false}, {{1.45f, -0.95f, -0.27f}, 0.35f, true}};

float distance(const Ball &ball, vec3 origin, vec3 dir) {
    const vec3 away = origin - ball.centre;
    const float b = dot(away, dir), inside = b * b - dot(away, away) + ball.radius * ball.radius;
    if (inside < 0.0f) {
        return infinity;
    }
    const float root = std::sqrt(inside);
    return -b - root > 1e-3f ? -b - root : -b + root > 1e-3f ? -b + root : infinity;
}

// A ray in flight, and the colour and opacity of the fields in front of the surface that the ray meets.
struct Path {
    vec3 origin, dir, light;
    float t_max;
    std::uint32_t x;
    int surface; // of the balls, or -1 for the floor, -2 for none
    float seen[4];
};
struct Shadow {
    vec3 origin, dir, light;
    std::uint32_t x;
    float opacity;
};

// State of one thread.
struct Tracer {
    nerf::worker colours, shadows;
    double in_fields = 0.0;
    std::vector<Path> wave, next;
    std::vector<Shadow> waiting;

    // Renders the fields along a wave of rays; `look_at_the_sun` renders the opacity along shadow rays.
    void look() {
        const Stopwatch watch;
        const nerf::rays rays{nerf::member(wave, &Path::origin), nerf::member(wave, &Path::dir), {},
                              nerf::member(wave, &Path::t_max)};
        const nerf::target target{nerf::plane::member(wave, &Path::seen)}; // linear, premultiplied
        expect(colours.render_rays(rays, target));
        in_fields += watch.seconds();
    }
    void look_at_the_sun() {
        const Stopwatch watch;
        const nerf::rays rays{nerf::member(waiting, &Shadow::origin), nerf::member(waiting, &Shadow::dir)};
        const nerf::target target{{}, nerf::plane::member(waiting, &Shadow::opacity)};
        expect(shadows.render_rays(rays, target));
        in_fields += watch.seconds();
    }

    void meet_surfaces() {
        for (Path &path : wave) {
            path.t_max = floor_distance(path.origin, path.dir);
            path.surface = path.t_max < infinity ? -1 : -2;
            for (int i = 0; i < 2; ++i) {
                const float t = distance(balls[i], path.origin, path.dir);
                if (t < path.t_max) {
                    path.t_max = t;
                    path.surface = i;
                }
            }
        }
    }

    void send(const Path &from, vec3 origin, vec3 dir, vec3 light) {
        if (std::max({light.x, light.y, light.z}) > faintest) {
            next.push_back({origin, dir, light, 0.0f, from.x, 0, {}});
        }
    }

    // Adds the sky's light on the floor to the row at once. The sun's light waits for the result of a shadow ray.
    void leave(const Path &path, vec3 light, vec3 *row) {
        if (path.surface == -2) {
            row[path.x] = row[path.x] + times(light, sky(path.dir));
            return;
        }
        const vec3 p = path.origin + path.t_max * path.dir;
        if (path.surface == -1) {
            const vec3 colour = times(light, floor_colour(p));
            row[path.x] = row[path.x] + 0.45f * times(colour, sky({0.0f, 0.0f, 1.0f}));
            bool dark = false;
            for (const Ball &ball : balls) {
                dark = dark || (!ball.glass && distance(ball, p, to_sun) < infinity);
            }
            if (!dark) {
                waiting.push_back({p, to_sun, to_sun.z * times(colour, sun), path.x, 0.0f});
            }
            return;
        }
        const Ball &ball = balls[path.surface];
        const vec3 out = 1.0f / ball.radius * (p - ball.centre);
        const bool leaving = dot(out, path.dir) > 0.0f;
        const vec3 normal = leaving ? -1.0f * out : out;
        if (!ball.glass) {
            send(path, p, mirrored(path.dir, normal), 0.9f * light);
            return;
        }
        // Snell's law, and Schlick's estimate of the reflected fraction.
        const float ratio = leaving ? 1.5f : 1.0f / 1.5f, cosine = -dot(path.dir, normal);
        const float beyond = 1.0f - ratio * ratio * (1.0f - cosine * cosine);
        const float inside = leaving ? std::sqrt(std::max(beyond, 0.0f)) : cosine;
        const float part = beyond < 0.0f ? 1.0f : 0.04f + 0.96f * std::pow(1.0f - inside, 5.0f);
        send(path, p, mirrored(path.dir, normal), part * light);
        if (beyond >= 0.0f) {
            const vec3 dir = ratio * path.dir + (ratio * cosine - std::sqrt(beyond)) * normal;
            send(path, p, normalised(dir), (1.0f - part) * light);
        }
    }

    void trace(vec3 *row) {
        for (int bounce = 0; bounce < bounces && !wave.empty(); ++bounce) {
            meet_surfaces();
            look();
            for (const Path &path : wave) {
                const vec3 field{path.seen[0], path.seen[1], path.seen[2]};
                row[path.x] = row[path.x] + times(path.light, field);
                leave(path, (1.0f - path.seen[3]) * path.light, row);
            }
            look_at_the_sun();
            for (const Shadow &shadow : waiting) {
                row[shadow.x] = row[shadow.x] + (1.0f - shadow.opacity) * shadow.light;
            }
            waiting.clear();
            wave.swap(next);
            next.clear();
        }
    }
};

} // namespace

int main(int argc, char **argv) {
    const Arguments arguments(argc, argv, "threads", 2);
    const nerf::scene scene = expect(nerf::scene::open_file(arguments.scene));
    // Transform of the second instance: about half as large, turned by a quarter and moved into the first one.
    const float second[16] = {0.0f, 0.55f, 0.0f, 0.0f, -0.55f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.55f, 0.0f, 0.85f, 0.75f, -0.2f, 1.0f};
    const nerf::instance fields[] = {nerf::instance(scene), nerf::instance(scene, second)};
    nerf::options linear;
    linear.effects.linear = 1;
    std::vector<Tracer> tracers;
    for (int i = 0; i < arguments.last; ++i) {
        tracers.push_back({expect(nerf::worker::open(fields, NERF_OUTPUT_RGB, linear)),
                           expect(nerf::worker::open(fields, NERF_OUTPUT_OPACITY)), 0.0, {}, {}, {}});
    }
    const nerf::camera camera = view(arguments.width, arguments.height);
    Film film(arguments.width, arguments.height);
    const Stopwatch watch;
    in_rows(film.height, tracers, [&](std::uint32_t y, Tracer &tracer) {
        tracer.wave.clear();
        for (std::uint32_t x = 0; x < film.width; ++x) {
            const vec3 dir = direction(camera, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
            tracer.wave.push_back({camera.centre(), dir, {1.0f, 1.0f, 1.0f}, 0.0f, x, 0, {}});
        }
        tracer.trace(&film.pixels[std::size_t{y} * film.width]);
    });
    double in_fields = 0.0;
    for (const Tracer &tracer : tracers) {
        in_fields += tracer.in_fields / arguments.last;
    }
    const double all = watch.seconds();
    std::printf("%ux%u in %.2f s on %d threads, %.0f %% of it in the fields\n", film.width, film.height, all,
                arguments.last, 100.0 * in_fields / all);
    return film.save(arguments.prefix) ? EXIT_SUCCESS : EXIT_FAILURE;
}
