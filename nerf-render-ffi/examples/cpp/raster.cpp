// A z-buffer rasteriser with a field. Triangles are drawn first, then the field in front: each ray ends at the depth in
// the buffer. Two rings go through the scene, and a square lies below.
//
//     raster scene.nerf out_prefix [width height]
#include "world.hpp"

namespace {

using namespace world;

struct Mesh {
    std::vector<vec3> corners, normals;
    std::vector<std::uint32_t> triangles; // three corners each
    vec3 colour;
};

// Makes a ring around an axis.
Mesh ring(vec3 centre, vec3 axis, float radius, float thickness, vec3 colour) {
    constexpr std::uint32_t around = 96, across = 32;
    const vec3 side = normalised(cross(axis, {0.31f, 0.2f, 0.93f})), up = cross(axis, side);
    Mesh mesh{{}, {}, {}, colour};
    for (std::uint32_t i = 0; i < around; ++i) {
        for (std::uint32_t k = 0; k < across; ++k) {
            const float a = 6.2831853f * static_cast<float>(i) / around, b = 6.2831853f * static_cast<float>(k) / across;
            const vec3 out = std::cos(a) * side + std::sin(a) * up, normal = std::cos(b) * out + std::sin(b) * axis;
            mesh.corners.push_back(centre + radius * out + thickness * normal);
            mesh.normals.push_back(normal);
            const std::uint32_t j = (i + 1) % around, l = (k + 1) % across;
            for (const std::uint32_t corner : {i * across + k, j * across + k, i * across + l, j * across + k, j * across + l, i * across + l}) {
                mesh.triangles.push_back(corner);
            }
        }
    }
    return mesh;
}

// Makes a square below the scene.
Mesh ground() {
    const vec3 up{0.0f, 0.0f, 1.0f};
    const auto corner = [](float x, float y) { return vec3{x, y, floor_height}; };
    return {{corner(-1.8f, -1.8f), corner(1.9f, -1.8f), corner(1.9f, 1.9f), corner(-1.8f, 1.9f)}, {up, up, up, up},
            {0, 1, 2, 0, 2, 3}, {0.4f, 0.4f, 0.42f}};
}

// Colours, and depths along the view axis, world units.
struct Buffers {
    Film film;
    std::vector<float> depth;
};

void draw(const Mesh &mesh, const nerf::camera &camera, Buffers &to) {
    struct Corner {
        float x, y, w; // pixels, and one over the depth
        vec3 light;    // times w
    };
    std::vector<Corner> seen;
    for (std::size_t i = 0; i < mesh.corners.size(); ++i) {
        const vec3 from = mesh.corners[i] - camera.centre();
        const float depth = -dot(from, camera.backward()), w = 1.0f / depth;
        const float lit = std::max(0.0f, dot(mesh.normals[i], to_sun)), above = 0.35f + 0.15f * mesh.normals[i].z;
        seen.push_back({camera.cx + camera.fx * dot(from, camera.right()) * w,
                        camera.cy - camera.fy * dot(from, camera.up()) * w, w,
                        w * times(mesh.colour, lit * sun + above * sky({0.0f, 0.0f, 1.0f}))});
    }
    for (std::size_t i = 0; i + 2 < mesh.triangles.size(); i += 3) {
        const Corner &a = seen[mesh.triangles[i]], &b = seen[mesh.triangles[i + 1]], &c = seen[mesh.triangles[i + 2]];
        const auto edge = [](const Corner &p, const Corner &q, float x, float y) {
            return (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x);
        };
        const float area = edge(a, b, c.x, c.y);
        const auto last = [](float most, std::uint32_t side) { return std::min(most + 1.0f, static_cast<float>(side)); };
        for (float y = std::max(0.0f, std::floor(std::min({a.y, b.y, c.y}))) + 0.5f; y < last(std::max({a.y, b.y, c.y}), to.film.height); ++y) {
            for (float x = std::max(0.0f, std::floor(std::min({a.x, b.x, c.x}))) + 0.5f; x < last(std::max({a.x, b.x, c.x}), to.film.width); ++x) {
                const float u = edge(b, c, x, y) / area, v = edge(c, a, x, y) / area, rest = 1.0f - u - v;
                const float depth = 1.0f / (u * a.w + v * b.w + rest * c.w);
                const std::size_t pixel = static_cast<std::size_t>(y) * to.film.width + static_cast<std::size_t>(x);
                if (u >= 0.0f && v >= 0.0f && rest >= 0.0f && depth > 0.0f && depth < to.depth[pixel]) {
                    to.depth[pixel] = depth;
                    to.film.pixels[pixel] = depth * (u * a.light + v * b.light + rest * c.light);
                }
            }
        }
    }
}

} // namespace

int main(int argc, char **argv) {
    const Arguments arguments(argc, argv, "", 1);
    const nerf::camera camera = view(arguments.width, arguments.height);
    Buffers buffers{Film(arguments.width, arguments.height), {}};
    for (std::uint32_t i = 0; i < arguments.width * arguments.height; ++i) {
        const vec3 dir = direction(camera, static_cast<float>(i % arguments.width) + 0.5f, static_cast<float>(i / arguments.width) + 0.5f);
        buffers.film.pixels[i] = sky(dir);
        buffers.depth.push_back(infinity);
    }
    draw(ground(), camera, buffers);
    draw(ring({0.1f, 0.1f, -0.2f}, normalised({0.5f, -0.2f, 0.8f}), 1.0f, 0.07f, {0.8f, 0.25f, 0.1f}), camera, buffers);
    draw(ring({0.2f, 0.0f, -0.2f}, normalised({0.7f, 0.7f, 0.1f}), 0.75f, 0.05f, {0.2f, 0.5f, 0.2f}), camera, buffers);

    // The field, in front of what was drawn.
    const nerf::scene scene = expect(nerf::scene::open_file(arguments.scene));
    nerf::options linear;
    linear.effects.linear = 1;
    std::vector<float> field(4 * buffers.depth.size());
    nerf::target target;
    target.rgb = nerf::plane::rgba_f32(field);
    target.limit_z_depth = nerf::plane::limit(buffers.depth);
    nerf::worker worker = expect(scene.worker(target.outputs(), linear));
    const Stopwatch watch;
    expect(worker.render(camera, target));
    std::printf("the field in %.2f s\n", watch.seconds());
    for (std::size_t i = 0; i < buffers.depth.size(); ++i) {
        const float *const seen = &field[4 * i]; // premultiplied
        buffers.film.pixels[i] = vec3{seen[0], seen[1], seen[2]} + (1.0f - seen[3]) * buffers.film.pixels[i];
    }
    return buffers.film.save(arguments.prefix) ? EXIT_SUCCESS : EXIT_FAILURE;
}
