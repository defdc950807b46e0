// Embree traces a mesh with a field inside: the field is rendered along each ray up to the mesh.
//
//     embree scene.nerf out_prefix [width height]         (Debian: libembree-dev; link with -lembree3)
#include "world.hpp"

#include <embree3/rtcore.h>

namespace {

using namespace world;

// Three walls and a step: a corner around the field.
const vec3 corners[] = {{-1.6f, -1.6f, floor_height}, {2.0f, -1.6f, floor_height}, {2.0f, 2.0f, floor_height}, {-1.6f, 2.0f, floor_height},
                        {-1.6f, -1.6f, 1.3f}, {-1.6f, 2.0f, 1.3f}, {2.0f, 2.0f, 1.3f},
                        {-0.45f, -1.0f, -0.1f}, {-0.45f, 1.0f, -0.1f}, {-0.45f, 1.0f, 0.2f}, {-0.45f, -1.0f, 0.2f}};
const unsigned triangles[][3] = {{0, 1, 2}, {0, 2, 3}, {0, 3, 5}, {0, 5, 4}, {3, 2, 6}, {3, 6, 5}, {7, 8, 9}, {7, 9, 10}};
const vec3 colours[] = {{0.5f, 0.5f, 0.48f}, {0.6f, 0.3f, 0.22f}, {0.25f, 0.35f, 0.55f}, {0.75f, 0.65f, 0.25f}};

template <class T>
T *buffer(RTCGeometry mesh, RTCBufferType type, RTCFormat format, std::size_t count) {
    return static_cast<T *>(rtcSetNewGeometryBuffer(mesh, type, 0, format, sizeof(T), count));
}

RTCScene build(RTCDevice device) {
    RTCGeometry mesh = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    std::copy(std::begin(corners), std::end(corners),
              buffer<vec3>(mesh, RTC_BUFFER_TYPE_VERTEX, RTC_FORMAT_FLOAT3, std::size(corners)));
    struct Triangle {
        unsigned corners[3];
    };
    auto *const to = buffer<Triangle>(mesh, RTC_BUFFER_TYPE_INDEX, RTC_FORMAT_UINT3, std::size(triangles));
    for (std::size_t i = 0; i < std::size(triangles); ++i) {
        std::copy_n(triangles[i], 3, to[i].corners);
    }
    rtcCommitGeometry(mesh);
    RTCScene scene = rtcNewScene(device);
    rtcAttachGeometry(scene, mesh);
    rtcReleaseGeometry(mesh);
    rtcCommitScene(scene);
    return scene;
}

RTCRayHit hit(RTCScene mesh, vec3 origin, vec3 dir) {
    RTCRayHit ray = {};
    ray.ray = {origin.x, origin.y, origin.z, 1e-3f, dir.x, dir.y, dir.z, 0.0f, infinity, 0xffffffffu, 0, 0};
    ray.hit.geomID = ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(mesh, &context, &ray);
    return ray;
}

struct Ray {
    vec3 origin, dir;
    float t_max; // where Embree's mesh is
    float seen[4];
    vec3 shade, to_light;
    float shadow;
};

} // namespace

int main(int argc, char **argv) {
    const Arguments arguments(argc, argv, "", 1);
    const nerf::scene scene = expect(nerf::scene::open_file(arguments.scene));
    nerf::options linear;
    linear.effects.linear = 1;
    nerf::worker colours_of = expect(scene.worker(NERF_OUTPUT_RGB, linear));
    nerf::worker shadows_of = expect(scene.worker(NERF_OUTPUT_OPACITY));
    RTCDevice device = rtcNewDevice(nullptr);
    RTCScene mesh = build(device);

    const nerf::camera camera = view(arguments.width, arguments.height);
    Film film(arguments.width, arguments.height);
    std::vector<Ray> rays;
    std::vector<vec3> points;
    for (std::uint32_t i = 0; i < film.pixels.size(); ++i) {
        const vec3 dir = direction(camera, static_cast<float>(i % film.width) + 0.5f, static_cast<float>(i / film.width) + 0.5f);
        const RTCRayHit found = hit(mesh, camera.centre(), dir);
        Ray ray{camera.centre(), dir, found.ray.tfar, {}, sky(dir), to_sun, 0.0f};
        vec3 p = camera.centre();
        if (found.hit.geomID != RTC_INVALID_GEOMETRY_ID) {
            p = camera.centre() + found.ray.tfar * dir;
            const vec3 normal = normalised({found.hit.Ng_x, found.hit.Ng_y, found.hit.Ng_z});
            const float lit = hit(mesh, p, to_sun).ray.tfar < infinity ? 0.0f : std::fabs(dot(normal, to_sun));
            ray.shade = times(colours[found.hit.primID / 2], lit * sun);
        }
        points.push_back(p);
        rays.push_back(ray);
    }
    nerf::target target, shadow;
    target.rgb = nerf::plane::member(rays, &Ray::seen);
    shadow.opacity = nerf::plane::member(rays, &Ray::shadow);
    expect(colours_of.render_rays({nerf::member(rays, &Ray::origin), nerf::member(rays, &Ray::dir), {}, nerf::member(rays, &Ray::t_max)}, target));
    expect(shadows_of.render_rays({points, nerf::member(rays, &Ray::to_light)}, shadow));
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const Ray &ray = rays[i];
        vec3 behind = ray.shade;
        if (ray.t_max < infinity) { // the sun's light through the field, and the sky's
            const RTCRayHit found = hit(mesh, ray.origin, ray.dir);
            behind = (1.0f - ray.shadow) * behind + 0.4f * times(colours[found.hit.primID / 2], sky({0.0f, 0.0f, 1.0f}));
        }
        film.pixels[i] = vec3{ray.seen[0], ray.seen[1], ray.seen[2]} + (1.0f - ray.seen[3]) * behind;
    }
    rtcReleaseScene(mesh);
    rtcReleaseDevice(device);
    return film.save(arguments.prefix) ? EXIT_SUCCESS : EXIT_FAILURE;
}
