// Every wrapper of nerf_render.hpp, in a program without exceptions and without type information.
//
//     wrapper front.nerf plain.nerf picture.nerf damaged.nerf
#include "nerf_render.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>
#if __cplusplus >= 202002L
#include <span>
#endif

namespace {

int failures = 0;

#define CHECK(condition)                                                                                               \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            std::fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);                                       \
            ++failures;                                                                                                \
        }                                                                                                              \
    } while (false)

constexpr std::uint32_t width = 50, height = 41;
constexpr std::size_t pixels = std::size_t{width} * height;

std::vector<char> read(const char *path) {
    std::vector<char> bytes;
    std::FILE *const file = std::fopen(path, "rb");
    for (int c = file == nullptr ? EOF : std::fgetc(file); c != EOF; c = std::fgetc(file)) {
        bytes.push_back(static_cast<char>(c));
    }
    if (file != nullptr) {
        std::fclose(file);
    }
    return bytes;
}

bool says(const nerf::error &error, const char *what) { return std::strstr(error.text(), what) != nullptr; }

nerf::camera camera_of(const nerf::scene &scene) {
    auto camera = nerf::camera::from_vertical_fov(width, height, 0.8f);
    return camera.orbit(scene.centre(), scene.orbit_radius(), 0.5f, 0.3f);
}

float total(nerf::span<const float> values) {
    float sum = 0.0f;
    for (const float value : values) {
        sum += value;
    }
    return sum;
}

void views_are_made_of_what_lies_side_by_side() {
    float raw[3] = {1.0f, 2.0f, 3.0f};
    std::array<float, 2> array{4.0f, 5.0f};
    const std::vector<float> vector{6.0f};
    nerf::span<float> writable = raw;
    CHECK(total(raw) == 6.0f && total(array) == 9.0f && total(vector) == 6.0f && total(writable) == 6.0f);
    writable[1] = 0.0f;
    CHECK(raw[1] == 0.0f && writable.size() == 3 && !writable.empty() && nerf::span<float>().empty());
#if __cplusplus >= 202002L
    CHECK(total(std::span<const float>(vector)) == 6.0f);
#endif
    CHECK(nerf::bytes(vector).size() == sizeof(float) && nerf::bytes(raw).data() == raw);
    static_assert(!std::is_constructible_v<nerf::span<float>, const std::vector<float> &>);
    static_assert(!std::is_constructible_v<nerf::span<float>, std::vector<int> &>);
    // These would dangle.
    static_assert(!std::is_constructible_v<nerf::bytes, std::vector<char>>);
    static_assert(!std::is_constructible_v<nerf::bytes, std::array<char, 4>>);
    static_assert(!std::is_constructible_v<nerf::span<float>, std::vector<float>>);
    static_assert(!std::is_constructible_v<nerf::span<float>, std::array<float, 4>>);
    // These are views themselves, or last as long as the call they are an argument of.
    static_assert(std::is_constructible_v<nerf::bytes, nerf::span<const char>>);
    static_assert(std::is_constructible_v<nerf::span<float>, nerf::span<float>>);
    static_assert(std::is_constructible_v<nerf::span<const float>, std::vector<float>>);
}

void memory_is_owned_or_lent_and_moves() {
    auto owned = nerf::memory::allocate({1000, 64});
    CHECK(owned && owned->size() == 1000 && reinterpret_cast<std::uintptr_t>(owned->data()) % 64 == 0);
    nerf::memory home = std::move(*owned);
    CHECK(home.size() == 1000 && owned->size() == 0 && owned->data() == nullptr);
    // A value moves out of a result that goes away; of one that stays it is referred to.
    nerf::memory moved = *nerf::memory::allocate({10, 64});
    CHECK(moved.size() == 10 && nerf::memory::allocate({20, 64}).value().size() == 20);
    const auto kept = nerf::memory::allocate({30, 64});
    CHECK(&kept.value() == &*kept && kept.value().size() == 30 && kept->size() == 30);
    alignas(64) static unsigned char buffer[128];
    home = nerf::memory::lend(buffer);
    CHECK(home.data() == buffer && home.size() == sizeof buffer);
    const auto none = nerf::memory::allocate({std::numeric_limits<std::size_t>::max() / 2, 64});
    CHECK(!none && none.status() == NERF_STATUS_OUT_OF_MEMORY && says(none.error(), "heap"));
}

void scenes_open_in_any_memory(const std::vector<char> &blob, const char *path, const char *damaged) {
    const auto needed = nerf::scene::memory_layout(blob, NERF_KERNEL_PORTABLE);
    CHECK(needed && needed->size > 0 && needed->align == 64);
    auto home = nerf::memory::allocate(*needed);
    unsigned char *const first = static_cast<unsigned char *>(home->data());
    const auto lent = nerf::scene::open(blob, nerf::memory::lend(nerf::span(first, needed->size)), NERF_KERNEL_PORTABLE);
    CHECK(lent && lent->get() != nullptr && lent->info().kernel == NERF_KERNEL_PORTABLE && lent->info().samples == 48);
    CHECK(nerf::view(lent->info().data) == "noise");
    const nerf::span one_less(first, needed->size - 1);
    const auto small = nerf::scene::open(blob, nerf::memory::lend(one_less), NERF_KERNEL_PORTABLE);
    CHECK(!small && small.status() == NERF_STATUS_MEMORY && says(small.error(), "expected"));

    const auto file = nerf::scene::open_file(path);
    CHECK(file && file->info().parameters == lent->info().parameters && !file->is_picture());
    CHECK(nerf::scene::open_file(std::string(path)) && nerf::scene::open_file(std::filesystem::path(path)));
    const auto absent = nerf::scene::open_file("absent.nerf");
    CHECK(!absent && absent.status() == NERF_STATUS_FILE && says(absent.error(), "absent.nerf"));
    const auto broken = nerf::scene::open_file(damaged);
    CHECK(!broken && broken.status() == NERF_STATUS_BLOB_CHECKSUM);
    const auto nothing = nerf::scene::open(nerf::bytes(nullptr, 0));
    CHECK(!nothing && nothing.status() != NERF_STATUS_OK);
}

void what_was_moved_from_is_empty(const char *path) {
    auto opened = nerf::scene::open_file(path);
    nerf::scene scene = std::move(*opened);
    nerf::scene other;
    other = std::move(scene);
    CHECK(other.get() != nullptr && other.info().samples == 48);
    for (const nerf::scene *const empty : {&*opened, &scene}) {
        nerf::memory nowhere;
        nerf::options options;
        CHECK(empty->get() == nullptr && empty->info().kind == 0 && !empty->is_picture());
        CHECK(empty->worker(NERF_OUTPUT_RGB).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->worker_layout(NERF_OUTPUT_RGB).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->pace_workspace(NERF_OUTPUT_RGB).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->within_loss(0.1f, options).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->within_cost(0.1f, options).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->within_time(1.0f, {}, options).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->point(0, options).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->preset(NERF_PRESET_FAST, options).status() == NERF_STATUS_NULL_POINTER);
        const auto pace = empty->measure_pace(camera_of(other), NERF_OUTPUT_RGB, 1.0f, nowhere);
        CHECK(pace.status() == NERF_STATUS_NULL_POINTER);
    }
    auto first = *other.worker(NERF_OUTPUT_RGB);
    nerf::worker second = std::move(first), worker;
    worker = std::move(second);
    std::vector<std::uint8_t> rgb(3 * pixels);
    nerf::target target;
    target.rgb = nerf::plane::rgb_u8(rgb);
    CHECK(worker.get() != nullptr && worker.render(camera_of(other), target));
    for (nerf::worker *const empty : {&first, &second}) {
        std::array<float, 3> point{};
        char text[8];
        const nerf::rays rays{point, point};
        nerf::target one;
        one.rgb = nerf::plane::rgb_f32(point);
        CHECK(empty->get() == nullptr);
        CHECK(empty->render(camera_of(other), target).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->render_picture(width, height, target).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->render_rays(rays, one).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->sample_rays(rays, one).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->query(point, {}, nerf::span(point.data(), 1), {}).status() == NERF_STATUS_NULL_POINTER);
        CHECK(empty->explain(text).status() == NERF_STATUS_NULL_POINTER);
    }
}

void cameras_look_where_they_are_told(const nerf::scene &scene) {
    const auto close = [](float a, float b) { return std::fabs(a - b) < 1e-5f; };
    nerf::camera camera(width, height, 60.0f);
    CHECK(camera.fx == 60.0f && camera.cx == 0.5f * width && close(dot(camera.backward(), {0.0f, 0.0f, 1.0f}), 1.0f));
    camera.look_at({1.0f, 2.0f, 3.0f}, {4.0f, 2.0f, 3.0f});
    CHECK(close(dot(camera.backward(), {-1.0f, 0.0f, 0.0f}), 1.0f) && close(camera.up().z, 1.0f));
    CHECK(close(camera.right().y, -1.0f) && camera.centre().z == 3.0f);
    const nerf::vec3 ups[] = {{0.0f, 0.0f, 1.0f}, {0.0f, 1.0f, 0.0f}, {1.0f, 0.0f, 0.0f}, {0.0f, 0.0f, -1.0f}};
    for (const nerf::vec3 up : ups) {
        const nerf::vec3 target{0.5f, -1.0f, 2.0f};
        camera.orbit(target, 3.0f, 2.2f, 0.4f, up);
        const nerf::vec3 there = camera.centre() - target;
        CHECK(close(dot(there, there), 9.0f) && close(dot(there, up), 3.0f * std::sin(0.4f)));
        CHECK(close(dot(there, camera.backward()), 3.0f) && close(dot(camera.right(), up), 0.0f));
        CHECK(dot(camera.up(), up) > 0.0f);
        CHECK(close(dot(cross(camera.right(), camera.up()), camera.backward()), 1.0f));
    }
    // A renderer's own matrices say the same.
    {
        const nerf::vec3 r = camera.right(), u = camera.up(), b = camera.backward(), c = camera.centre();
        const float view[16] = {r.x, u.x, b.x, 0.0f, r.y, u.y, b.y, 0.0f, r.z, u.z, b.z, 0.0f,
                                -dot(r, c), -dot(u, c), -dot(b, c), 1.0f};
        float projection[16] = {};
        projection[0] = 2.0f * 60.0f / width;
        projection[5] = 2.0f * 50.0f / height;
        projection[8] = 0.1f;
        projection[9] = -0.2f;
        projection[10] = -1.02f;
        projection[11] = -1.0f;
        projection[14] = -0.2f;
        const auto same = nerf::camera::from_matrices(width, height, view, projection);
        CHECK(same && close(same->fx, 60.0f) && close(same->fy, 50.0f));
        CHECK(close(same->cx, 0.45f * width) && close(same->cy, 0.4f * height));
        for (int i = 0; i < 12; ++i) {
            CHECK(std::fabs(same->c2w[i] - camera.c2w[i]) < 2e-5f);
        }
        // Where OpenGL puts a point, its ray goes.
        const nerf::vec3 point = c + -2.0f * b + 0.3f * r + 0.2f * u;
        const float x = projection[0] * 0.3f / 2.0f - projection[8], y = projection[5] * 0.2f / 2.0f - projection[9];
        const auto towards = same->ray(0.5f * width * (x + 1.0f), 0.5f * height * (1.0f - y));
        CHECK(towards && close(dot(cross(towards->dir, point - c), cross(towards->dir, point - c)), 0.0f));
        // A depth of OpenGL's is where the point is, as is one of [0, 1], reversed and without a far plane.
        const auto far_to = [&](float m10, float m14, float ndc, float z) {
            float depths[16] = {};
            depths[10] = m10;
            depths[14] = m14;
            const float found = nerf::z_depth(ndc, depths);
            return std::isinf(z) ? found == z : std::fabs(found - z) < 1e-4f * z;
        };
        CHECK(far_to(projection[10], projection[14], (1.02f * 2.0f - 0.2f) / 2.0f, 2.0f));
        // From 1 to 4.
        CHECK(far_to(-5.0f / 3.0f, -8.0f / 3.0f, -1.0f, 1.0f) && far_to(-5.0f / 3.0f, -8.0f / 3.0f, 1.0f, 4.0f));
        CHECK(far_to(-4.0f / 3.0f, -4.0f / 3.0f, 0.0f, 1.0f) && far_to(-4.0f / 3.0f, -4.0f / 3.0f, 1.0f, 4.0f)); // [0, 1]
        CHECK(far_to(1.0f / 3.0f, 4.0f / 3.0f, 1.0f, 1.0f) && far_to(1.0f / 3.0f, 4.0f / 3.0f, 0.0f, 4.0f)); // reversed
        constexpr float infinity = std::numeric_limits<float>::infinity();
        CHECK(far_to(0.0f, 0.5f, 0.25f, 2.0f) && far_to(0.0f, 0.5f, 0.0f, infinity)); // reversed, without a far plane
        CHECK(far_to(-1.0f, -1.0f, 0.75f, 4.0f) && far_to(-1.0f, -1.0f, 1.0f, infinity));
        CHECK(std::isnan(nerf::z_depth(0.5f, nerf::span<const float>(projection, 12))));
        // An inverse that was computed may have a last number that is 1 by rounding only.
        float inverse[16];
        std::copy_n(view, 16, inverse);
        inverse[15] = 0.99999994f;
        CHECK(nerf::camera::from_matrices(width, height, inverse, projection));
        projection[11] = 0.0f;
        CHECK(nerf::camera::from_matrices(width, height, view, projection).status() == NERF_STATUS_CAMERA);
        projection[11] = -1.0f;
        float mirrored[16];
        std::copy_n(view, 16, mirrored);
        mirrored[0] = -mirrored[0], mirrored[4] = -mirrored[4], mirrored[8] = -mirrored[8];
        CHECK(nerf::camera::from_matrices(width, height, mirrored, projection).status() == NERF_STATUS_CAMERA);
        CHECK(nerf::camera::from_matrices(width, height, nerf::span(view, 15), projection).status() == NERF_STATUS_CAMERA);
    }
    // The middle of the image looks along the view axis; a corner's ray is longer than deep.
    const auto middle = camera.ray(0.5f * width, 0.5f * height), corner = camera.ray(0.0f, 0.0f);
    CHECK(middle && corner && middle->origin.x == camera.centre().x);
    CHECK(close(dot(middle->dir, camera.backward()), -1.0f));
    CHECK(close(middle->z_per_distance, 1.0f) && close(corner->z_per_distance, -dot(corner->dir, camera.backward())));
    CHECK(dot(corner->dir, camera.up()) > 0.0f && dot(corner->dir, camera.right()) < 0.0f);
    // The tangent of half the field of view is half the height over the focal length.
    CHECK(close(nerf::camera::from_vertical_fov(7, 100, 1.5707963f).fy, 50.0f));

    std::vector<std::uint8_t> rgb(3 * pixels);
    nerf::target target;
    target.rgb = nerf::plane::rgb_u8(rgb);
    auto worker = scene.worker(target.outputs());
    camera.look_at({0.0f, 0.0f, 4.0f}, {}, {0.0f, 0.0f, 1.0f}); // along `up`: no such view
    CHECK(worker->render(camera, target).status() == NERF_STATUS_CAMERA);
    CHECK(camera.ray(1.0f, 1.0f).status() == NERF_STATUS_CAMERA);
}

struct Pixel {
    float rgba[4], opacity, ray_distance, z_depth, median_distance, normal[3];
    std::uint32_t untouched;
};

// One rendering of all planes into vectors, and the same in strides, upside down, in tiles and in windows.
void targets_may_be_any_shape(const nerf::scene &scene) {
    const nerf::camera camera = camera_of(scene);
    std::vector<float> rgba(4 * pixels), opacity(pixels), ray(pixels), z(pixels), median(pixels), normals(3 * pixels);
    nerf::target target;
    target.rgb = nerf::plane::rgba_f32(rgba);
    target.opacity = nerf::plane::f32(opacity);
    target.ray_distance = nerf::plane::f32(ray);
    target.z_depth = nerf::plane::f32(z);
    target.median_distance = nerf::plane::f32(median);
    target.normals = nerf::plane::vec3_f32(normals);
    CHECK(target.outputs() == 63);
    auto worker = scene.worker(target.outputs());
    const auto whole = worker->render(camera, target);
    CHECK(whole && whole->rays == pixels && whole->normal_evaluations > 0);
    CHECK(total(opacity) > 1.0f && total(opacity) < static_cast<float>(pixels));

    // Channels of one structure, tile by tile; the counters of the tiles add up.
    std::vector<Pixel> structures(pixels, Pixel{{}, 0, 0, 0, 0, {}, 77});
    const std::size_t stride = sizeof(Pixel), floats = pixels * stride / sizeof(float);
    float *const first = structures[0].rgba;
    nerf::target strided;
    strided.rgb = nerf::plane::member(structures, &Pixel::rgba);
    strided.opacity = nerf::plane::member(structures, &Pixel::opacity);
    strided.ray_distance = nerf::plane::f32(nerf::span(first + 5, floats - 5), {width * stride, stride});
    strided.z_depth = nerf::plane::member(structures, &Pixel::z_depth);
    strided.median_distance = nerf::plane::member(structures, &Pixel::median_distance);
    strided.normals = nerf::plane::member(structures, &Pixel::normal, true);
    const nerf::tiles tiles{width, height, 16};
    CHECK(tiles.size() == 12 && tiles[11].width == 2 && tiles[11].height == 9);
    nerf::counters sum;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
        const auto part = worker->render(camera, strided, tiles[i]);
        CHECK(part);
        sum += *part;
    }
    CHECK(std::memcmp(&sum, &*whole, sizeof sum) == 0);
    bool equal = true;
    for (std::size_t i = 0; i < pixels; ++i) {
        const Pixel &p = structures[i];
        equal = equal && std::memcmp(p.rgba, &rgba[4 * i], sizeof p.rgba) == 0 && p.opacity == opacity[i] &&
                p.ray_distance == ray[i] && p.z_depth == z[i] && p.median_distance == median[i] &&
                std::memcmp(p.normal, &normals[3 * i], sizeof p.normal) == 0 && p.untouched == 77;
    }
    CHECK(equal);

    // Rows that go up, from the last row of the memory.
    std::vector<float> upwards(pixels);
    nerf::target up;
    up.z_depth = nerf::plane::f32(upwards, {-std::ptrdiff_t{width * sizeof(float)}, 0});
    CHECK(worker->render(camera, up));
    for (std::size_t y = 0; y < height; ++y) {
        equal = equal && std::memcmp(&upwards[(height - 1 - y) * width], &z[y * width], width * sizeof(float)) == 0;
    }
    CHECK(equal);

    // A window has memory for itself alone.
    const nerf::rect window{11, 7, 20, 10};
    std::vector<float> small(200, -1.0f);
    nerf::target in_window;
    in_window.z_depth = nerf::plane::f32(small);
    in_window.window = window;
    CHECK(worker->render(camera, in_window, nerf::rect{11, 7, 20, 5}));
    CHECK(worker->render(camera, in_window, nerf::rect{11, 12, 20, 5}));
    for (std::size_t y = 0; y < 10; ++y) {
        equal = equal && std::memcmp(&small[y * 20], &z[(7 + y) * width + 11], 20 * sizeof(float)) == 0;
    }
    CHECK(equal);

    // Nothing is written outside of a view.
    CHECK(worker->render(camera, in_window, nerf::rect{10, 7, 1, 1}).status() == NERF_STATUS_RECT);
    CHECK(worker->render(camera, in_window).status() == NERF_STATUS_RECT);
    nerf::target short_one;
    short_one.z_depth = nerf::plane::f32(nerf::span(small.data(), 199));
    short_one.window = window;
    CHECK(worker->render(camera, short_one, window).status() == NERF_STATUS_MEMORY);
    CHECK(worker->render(camera, short_one, nerf::rect{11, 7, 20, 9}));
    short_one.z_depth = nerf::plane::f32(small, {-84, 0});
    CHECK(worker->render(camera, short_one, window).status() == NERF_STATUS_MEMORY);
    short_one.z_depth = nerf::plane::f32(small, {0, std::size_t{1} << 31});
    CHECK(worker->render(camera, short_one, window).status() == NERF_STATUS_OVERFLOW);
    short_one.z_depth = nerf::plane::f32(small, {0, std::size_t{1} << 29}); // and so a row of twenty such
    CHECK(worker->render(camera, short_one, window).status() == NERF_STATUS_OVERFLOW);
    // Rows that go up by one pixel each: the last pixel is inside, but not the first row's end.
    short_one.z_depth = nerf::plane::f32(nerf::span(small.data(), 20), {-4, 0});
    CHECK(worker->render(camera, short_one, window).status() == NERF_STATUS_MEMORY);
    CHECK(worker->render(camera, {}).status() == NERF_STATUS_TARGET);

    // Eight bits, and colour over the background.
    std::vector<std::uint8_t> bytes(3 * pixels), bytes4(4 * pixels);
    std::vector<float> rgb(3 * pixels);
    nerf::target colour;
    colour.rgb = nerf::plane::rgb_f32(rgb);
    CHECK(worker->render(camera, colour));
    colour.rgb = nerf::plane::rgb_u8(bytes);
    CHECK(worker->render(camera, colour));
    colour.rgb = nerf::plane::rgba_u8(bytes4);
    CHECK(worker->render(camera, colour));
    for (std::size_t i = 0; i < pixels; ++i) {
        const auto alpha = static_cast<std::uint8_t>(rgba[4 * i + 3] * 255.0f + 0.5f);
        const auto red = static_cast<std::uint8_t>(rgb[3 * i] * 255.0f + 0.5f);
        equal = equal && bytes[3 * i] == red && bytes4[4 * i + 3] == alpha;
    }
    CHECK(equal);
}

bool go_on(std::uint64_t, std::uint64_t) { return true; }

void progress_may_be_any_callable_and_cancels_whole_tiles(const nerf::scene &scene) {
    const nerf::camera camera = camera_of(scene);
    std::vector<float> z(pixels, -1.0f), all(pixels);
    nerf::target target;
    target.z_depth = nerf::plane::f32(all);
    auto worker = scene.worker(target.outputs());
    std::uint64_t last = 0;
    int calls = 0;
    CHECK(worker->render(camera, target, nerf::whole, [&](std::uint64_t done, std::uint64_t of) {
        CHECK(done >= last && of == pixels);
        last = done;
    }));
    CHECK(last == pixels);
    CHECK(worker->render(camera, target, nerf::whole, [&calls] { ++calls; }));
    CHECK(calls == 13);
    struct Counting {
        int left;
        bool operator()() { return left-- > 0; }
    } counting{5};
    target.z_depth = nerf::plane::f32(z);
    const auto cancelled = worker->render(camera, target, nerf::whole, counting);
    CHECK(!cancelled && cancelled.status() == NERF_STATUS_CANCELLED && says(cancelled.error(), "cancel"));
    CHECK(counting.left == -1);
    const nerf::tiles tiles{width, height, 16};
    std::size_t finished = 0;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
        const nerf::rect tile = tiles[i];
        std::size_t equal = 0, untouched = 0;
        for (std::uint32_t y = tile.y; y < tile.y + tile.height; ++y) {
            for (std::uint32_t x = tile.x; x < tile.x + tile.width; ++x) {
                equal += z[y * width + x] == all[y * width + x];
                untouched += z[y * width + x] == -1.0f;
            }
        }
        const std::size_t size = std::size_t{tile.width} * tile.height;
        CHECK(equal == size || untouched == size);
        finished += equal == size;
    }
    CHECK(finished == 5);
    CHECK(worker->render(camera, target, nerf::whole, &go_on));
    CHECK(worker->render(camera, target, nerf::whole, go_on));
    // An empty view is no plane that was left out.
    std::vector<float> nothing;
    nerf::target short_of = target;
    short_of.opacity = nerf::plane::f32(nothing);
    CHECK(worker->render(camera, short_of).status() == NERF_STATUS_MEMORY);
    CHECK(std::memcmp(z.data(), all.data(), pixels * sizeof(float)) == 0);
}

void effects_and_settings_reach_the_frame(const nerf::scene &scene) {
    const nerf::camera camera = camera_of(scene);
    std::vector<float> rgb(3 * pixels), other(3 * pixels);
    nerf::target target;
    target.rgb = nerf::plane::rgb_f32(rgb);
    nerf::options options;
    options.effects.anti_aliasing = 4;
    auto worker = scene.worker(target.outputs(), options);
    const auto four = worker->render(camera, target);
    CHECK(four && four->rays == 4 * pixels);
    target.rgb = nerf::plane::rgb_f32(other);
    const auto cut = scene.worker(target.outputs())->render(camera, target);
    const auto uncut = scene.worker(target.outputs(), nerf::options::uncut())->render(camera, target);
    CHECK(cut && uncut && uncut->colour_evaluations > cut->colour_evaluations && rgb != other);
    options.effects.anti_aliasing = 257;
    const auto wrong = scene.worker(target.outputs(), options);
    CHECK(!wrong && wrong.status() == NERF_STATUS_OPTIONS && says(wrong.error(), "anti_aliasing"));
#if __cplusplus >= 202002L
    const nerf::target to{.rgb = nerf::plane::rgb_f32(other)};
    nerf::options coarse;
    coarse.samples = 8;
    const auto few = scene.worker(to.outputs(), coarse)->render(camera, to);
    CHECK(few && few->density_evaluations < cut->density_evaluations);
#endif

    // A worker in memory of the caller's; some that is too small, or lies askew.
    const auto needed = scene.worker_layout(target.outputs());
    auto home = *nerf::memory::allocate({needed->size + 4, needed->align});
    auto *const first = static_cast<unsigned char *>(home.data());
    const auto lent = [&](std::size_t from, std::size_t size) {
        return scene.worker(target.outputs(), {}, nerf::memory::lend(nerf::span(first + from, size)));
    };
    CHECK(lent(0, needed->size)->render(camera, target));
    CHECK(lent(0, needed->size - 1).status() == NERF_STATUS_MEMORY);
    CHECK(lent(4, needed->size).status() == NERF_STATUS_ALIGNMENT);
    // One plane more than it was opened for.
    auto one = scene.worker(target.outputs());
    target.z_depth = nerf::plane::f32(nerf::span(rgb.data(), pixels));
    const auto more = one->render(camera, target);
    CHECK(more.status() == NERF_STATUS_TARGET && says(more.error(), "z_depth"));
}

struct Ray {
    int id;
    nerf::vec3 origin;
    float range[2];
    nerf::vec3 dir;
    float t_min, t_max, random;
};

struct Hit {
    nerf::vec3 normal;
    float rgba[4], opacity, distance;
    int untouched;
};

void rays_are_a_host_s_own(const nerf::scene &scene) {
    const nerf::camera camera = camera_of(scene);
    std::vector<float> rgba(4 * pixels), z(pixels), limits(pixels);
    nerf::target frame;
    frame.rgb = nerf::plane::rgba_f32(rgba);
    frame.z_depth = nerf::plane::f32(z);
    auto worker = *scene.worker(63);
    CHECK(worker.render(camera, frame));
    std::vector<Ray> rays(pixels);
    std::vector<Hit> hits(pixels, Hit{{}, {}, 0.0f, 0.0f, 77});
    for (std::uint32_t i = 0; i < pixels; ++i) {
        const auto from = camera.ray(static_cast<float>(i % width) + 0.5f, static_cast<float>(i / width) + 0.5f);
        rays[i] = {0, from->origin, {}, from->dir, 0.0f, 2.0f + 0.001f * static_cast<float>(i), 0.999f};
        limits[i] = rays[i].t_max;
    }
    nerf::target to;
    to.rgb = nerf::plane::member(hits, &Hit::rgba);
    to.opacity = nerf::plane::member(hits, &Hit::opacity);
    to.normals = nerf::plane::member(hits, &Hit::normal, true);
    to.ray_distance = nerf::plane::member(hits, &Hit::distance);
    nerf::rays all;
    all.origins = nerf::member(rays, &Ray::origin);
    all.dirs = nerf::member(rays, &Ray::dir);
    const auto counters = worker.render_rays(all, to);
    CHECK(counters && counters->rays == pixels);
    bool equal = true;
    for (std::size_t i = 0; i < pixels; ++i) {
        equal = equal && std::memcmp(hits[i].rgba, &rgba[4 * i], sizeof hits[i].rgba) == 0 && hits[i].untouched == 77;
    }
    CHECK(equal);
    // Depths need an axis; with the camera's they are the frame's.
    std::vector<float> depths(pixels);
    to.z_depth = nerf::plane::f32(depths);
    CHECK(worker.render_rays(all, to).status() == NERF_STATUS_NULL_POINTER);
    all.axis = -1.0f * camera.backward();
    CHECK(worker.render_rays(all, to) && depths == z);
    // The end of a ray is the limit of a pixel.
    all.t_min = nerf::member(rays, &Ray::t_min);
    all.t_max = nerf::member(rays, &Ray::t_max);
    frame.limit_ray_distance = nerf::plane::limit(limits);
    CHECK(worker.render_rays(all, to) && worker.render(camera, frame));
    for (std::size_t i = 0; i < pixels; ++i) {
        equal = equal && std::memcmp(hits[i].rgba, &rgba[4 * i], sizeof hits[i].rgba) == 0;
    }
    CHECK(equal);
    all.t_max = {};
    // A photon collides where there is something, or not at all.
    CHECK(worker.sample_rays(all, to).status() == NERF_STATUS_NULL_POINTER);
    all.random = nerf::member(rays, &Ray::random);
    CHECK(worker.sample_rays(all, to));
    for (const Hit &hit : hits) {
        equal = equal && (hit.opacity == 1.0f ? std::isfinite(hit.distance) : hit.opacity == 0.0f && std::isinf(hit.distance));
    }
    CHECK(equal);
    // Views of other lengths, and a ray that is none.
    all.random = nerf::numbers<const float>(nerf::span<const float>(z.data(), 7));
    CHECK(worker.sample_rays(all, to).status() == NERF_STATUS_MEMORY);
    all.random = {};
    rays[5].dir.x = 3.0f;
    const auto wrong = worker.render_rays(all, to);
    CHECK(wrong.status() == NERF_STATUS_RAY && says(wrong.error(), "rays[5]"));
}

void one_ray_in_one_call_is_one_of_many(const nerf::scene &scene) {
    const nerf::camera camera = camera_of(scene);
    struct doubles {
        double x, y, z;
    };
    std::vector<Ray> rays;
    std::vector<float> rgba(4 * width), normals(3 * width), opacity(width), distance(width), median(width);
    for (std::uint32_t x = 0; x < width; ++x) {
        const auto from = *camera.ray(static_cast<float>(x) + 0.5f, 0.5f * height);
        rays.push_back({0, from.origin, {}, from.dir, 0.25f, 2.5f + 0.03f * static_cast<float>(x), 0.02f * static_cast<float>(x)});
    }
    nerf::rays all;
    all.origins = nerf::member(rays, &Ray::origin);
    all.dirs = nerf::member(rays, &Ray::dir);
    all.t_min = nerf::member(rays, &Ray::t_min);
    all.t_max = nerf::member(rays, &Ray::t_max);
    nerf::target to;
    to.rgb = nerf::plane::rgba_f32(rgba);
    to.opacity = nerf::plane::f32(opacity);
    to.ray_distance = nerf::plane::f32(distance);
    to.median_distance = nerf::plane::f32(median);
    to.normals = nerf::plane::vec3_f32(normals);
    auto worker = *scene.worker(to.outputs() | NERF_OUTPUT_Z_DEPTH);
    bool equal = true, opaque = false;
    const auto compare = [&](std::size_t i, const nerf::result<nerf::pixel> &seen) {
        equal = equal && seen && std::memcmp(&seen->rgb, &rgba[4 * i], 3 * sizeof(float)) == 0 && seen->opacity == opacity[i] &&
                seen->ray_distance == distance[i] && seen->median_distance == median[i] &&
                std::memcmp(&seen->normal, &normals[3 * i], 3 * sizeof(float)) == 0;
        opaque = opaque || seen->opacity > 0.5f;
    };
    CHECK(worker.render_rays(all, to));
    for (std::size_t i = 0; i < width; ++i) {
        const Ray &ray = rays[i];
        const doubles origin{ray.origin.x, ray.origin.y, ray.origin.z};
        const std::array<double, 3> dir{ray.dir.x, ray.dir.y, ray.dir.z};
        compare(i, worker.render_ray(ray.origin, ray.dir, ray.t_min, ray.t_max));
        compare(i, worker.render_ray(origin, dir, 0.25, static_cast<double>(ray.t_max)));
    }
    all.random = nerf::member(rays, &Ray::random);
    CHECK(equal && opaque && worker.sample_rays(all, to));
    for (std::size_t i = 0; i < width; ++i) {
        const float dir[3] = {rays[i].dir.x, rays[i].dir.y, rays[i].dir.z};
        compare(i, worker.sample_ray(rays[i].origin, dir, static_cast<double>(rays[i].random), 0.25, rays[i].t_max));
    }
    CHECK(equal);
    // To the end of the world, also where a host writes it in doubles; and a shadow ray's opacity alone.
    auto shadows = *scene.worker(NERF_OUTPUT_OPACITY);
    const Ray &middle = rays[width / 2];
    const auto endless = worker.render_ray(middle.origin, middle.dir), shadow = shadows.render_ray(middle.origin, middle.dir);
    const auto far = worker.render_ray(middle.origin, middle.dir, 0, std::numeric_limits<double>::max());
    CHECK(endless && far && shadow && std::memcmp(&*endless, &*far, sizeof *far) == 0);
    CHECK(shadow->opacity == endless->opacity && shadow->rgb.x == 0.0f && shadow->ray_distance == 0.0f);
    const auto wrong = worker.render_ray(middle.origin, 3.0f * middle.dir);
    CHECK(wrong.status() == NERF_STATUS_RAY && says(wrong.error(), "rays[0]"));
    CHECK(worker.sample_ray(middle.origin, middle.dir, 1.5).status() == NERF_STATUS_RAY);
    CHECK(scene.worker(NERF_OUTPUT_Z_DEPTH)->render_ray(middle.origin, middle.dir).status() == NERF_STATUS_TARGET);
    nerf::worker moved = std::move(worker);
    CHECK(moved.render_ray(middle.origin, middle.dir)->opacity == endless->opacity);
    CHECK(worker.render_ray(middle.origin, middle.dir).status() == NERF_STATUS_NULL_POINTER);
}

void fields_stand_where_a_host_puts_them(const nerf::scene &scene) {
    const nerf::camera camera = camera_of(scene);
    std::vector<float> alone(4 * pixels), placed(4 * pixels);
    nerf::target target;
    target.rgb = nerf::plane::rgba_f32(alone);
    const nerf::options uncut = nerf::options::uncut();
    CHECK(scene.worker(target.outputs(), uncut)->render(camera, target));
    // Twice as large about its middle, seen from twice as far away.
    const nerf::vec3 c = scene.centre();
    const float matrix[16] = {2.0f, 0.0f, 0.0f, 0.0f, 0.0f, 2.0f, 0.0f, 0.0f, 0.0f, 0.0f, 2.0f, 0.0f, -c.x, -c.y, -c.z, 1.0f};
    const std::vector<nerf::instance> one{nerf::instance(scene, matrix)};
    nerf::camera farther = camera;
    const nerf::vec3 eye = 2.0f * camera.centre() - c;
    farther.c2w[3] = eye.x;
    farther.c2w[7] = eye.y;
    farther.c2w[11] = eye.z;
    target.rgb = nerf::plane::rgba_f32(placed);
    const auto layout = nerf::worker::memory_layout(one, target.outputs(), uncut);
    auto worker = nerf::worker::open(one, target.outputs(), uncut, *nerf::memory::allocate(*layout));
    CHECK(worker && worker->render(farther, target));
    float worst = 0.0f;
    for (std::size_t i = 0; i < alone.size(); ++i) {
        worst = std::fmax(worst, std::fabs(alone[i] - placed[i]));
    }
    CHECK(worst < 0.02f);
    // Both at once are as dense as one of twice the density.
    const std::array<nerf::instance, 2> both{nerf::instance(scene), nerf::instance(scene)};
    CHECK(nerf::worker::open(both, target.outputs(), uncut)->render(camera, target));
    worst = 0.0f;
    for (std::size_t i = 0; i < pixels; ++i) {
        const float through = 1.0f - alone[4 * i + 3];
        worst = std::fmax(worst, std::fabs(1.0f - placed[4 * i + 3] - through * through));
    }
    CHECK(worst < 1e-3f);
    const float mirror[16] = {-1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 1.0f};
    const nerf::instance mirrored[1] = {nerf::instance(scene, mirror)};
    const auto refused = nerf::worker::open(mirrored, target.outputs());
    CHECK(refused.status() == NERF_STATUS_TRANSFORM && says(refused.error(), "mirrored"));
    const nerf::instance cut_short[1] = {nerf::instance(scene, nerf::span(mirror, 15))};
    CHECK(nerf::worker::open(cut_short, target.outputs()).status() == NERF_STATUS_TRANSFORM);
    // The rows of C's to_world are not 16 numbers.
    const nerf::instance rows[2] = {nerf::instance(scene), nerf::instance(scene, nerf::span(mirror, 12))};
    const auto short_of = nerf::worker::open(rows, target.outputs());
    CHECK(short_of.status() == NERF_STATUS_TRANSFORM &&
          says(short_of.error(), "instances[1]: expected a matrix of 16 floats"));
    // A translation in row-major order is where a column-major matrix has zeros.
    const float row_major[16] = {1.0f, 0.0f, 0.0f, 0.5f, 0.0f, 1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 1.0f};
    const nerf::instance transposed[1] = {nerf::instance(scene, row_major)};
    const auto in_rows = nerf::worker::open(transposed, target.outputs());
    CHECK(in_rows.status() == NERF_STATUS_TRANSFORM && says(in_rows.error(), "column-major"));
    CHECK(nerf::worker::memory_layout(rows, target.outputs()).status() == NERF_STATUS_TRANSFORM);
    CHECK(nerf::worker::open(rows, target.outputs(), {}, nerf::memory()).status() == NERF_STATUS_TRANSFORM);
    CHECK(nerf::worker::open({}, target.outputs()).status() == NERF_STATUS_NULL_POINTER);
}

void points_can_be_asked(const nerf::scene &scene) {
    auto worker = scene.worker(NERF_OUTPUT_RGB);
    const nerf::vec3 middle = scene.centre();
    const std::vector<float> positions{middle.x, middle.y, middle.z, 9.0f, 9.0f, 9.0f};
    const std::array<float, 6> dirs{0.0f, 0.0f, 1.0f, 1.0f, 0.0f, 0.0f};
    float sigma[2] = {-1.0f, -1.0f}, rgb[6], again[2];
    CHECK(worker->query(positions, dirs, sigma, rgb));
    CHECK(sigma[0] >= 0.0f && sigma[1] == 0.0f && rgb[3] == 0.0f);
    CHECK(worker->query(positions, {}, again, {}) && again[0] == sigma[0]);
    // A host's own vectors, and nobody's copies of them.
    struct colour { float r, g, b; };
    const std::vector<nerf::vec3> points{{positions[0], positions[1], positions[2]}};
    const std::array<nerf::vec3, 1> along{{{dirs[0], dirs[1], dirs[2]}}};
    std::vector<colour> colours(1);
    CHECK(worker->query(points, along, nerf::span(again, 1), colours));
    CHECK(again[0] == sigma[0] && colours[0].r == rgb[0] && colours[0].b == rgb[2]);
    struct four { float x, y, z, w; };
    static_assert(!std::is_constructible_v<nerf::triples<const float>, std::vector<four> &>);
    static_assert(!std::is_constructible_v<nerf::triples<float>, const std::vector<colour> &>);
    static_assert(!std::is_constructible_v<nerf::triples<float>, std::vector<colour>>);
    CHECK(worker->query(positions, {}, sigma, rgb).status() == NERF_STATUS_MEMORY);
    CHECK(worker->query(nerf::span(positions.data(), 5), {}, sigma, {}).status() == NERF_STATUS_MEMORY);
    const std::array<float, 6> long_dirs{0.0f, 0.0f, 2.0f, 1.0f, 0.0f, 0.0f};
    CHECK(worker->query(positions, long_dirs, sigma, rgb).status() == NERF_STATUS_DIRECTION);
    CHECK(worker->query({}, {}, {}, {}));
}

void quality_has_a_price(const nerf::scene &scene, const nerf::scene &without) {
    nerf::options options, cheap;
    options.effects.anti_aliasing = cheap.effects.anti_aliasing = 3;
    const auto least = scene.within_loss(0.0f, options), most = scene.within_loss(100.0f, cheap);
    CHECK(least && most && most->within == 1 && most->cost <= least->cost && cheap.effects.anti_aliasing == 3);
    const auto cost = scene.within_cost(most->cost, cheap);
    CHECK(cost && cost->cost == most->cost && std::isnan(cost->milliseconds));
    const auto point = scene.point(1, options);
    CHECK(scene.info().front_points == 2 && point && point->loss_db == 0.5f && options.transmittance_cut == 0.01f);
    CHECK(scene.point(2, options).status() == NERF_STATUS_OPTIONS);
    CHECK(scene.preset(NERF_PRESET_PREVIEW, options));
    CHECK(scene.preset(static_cast<nerf_preset>(99), options).status() == NERF_STATUS_OPTIONS);

    auto workspace = scene.pace_workspace(NERF_OUTPUT_RGB);
    std::uint64_t now = 0;
    const auto clock = [&now] { return now += 1000; };
    const auto pace = scene.measure_pace(camera_of(scene), NERF_OUTPUT_RGB, 1e9f, *workspace, {}, clock);
    CHECK(pace && now > 0 && pace->milliseconds[0] > 0.0f && std::isinf(pace->milliseconds[15]));
    CHECK(pace->shared_among(4).milliseconds[0] == pace->milliseconds[0] / 4.0f);
    const auto timed = scene.within_time(1e9f, *pace, options);
    CHECK(timed && timed->within == 1 && timed->milliseconds > 0.0f);
    CHECK(scene.measure_pace(camera_of(scene), NERF_OUTPUT_RGB, 1e9f, *workspace)); // the library's clock
    CHECK(without.within_loss(0.1f, options).status() == NERF_STATUS_NO_FRONT);
}

void frames_explain_themselves(const nerf::scene &scene) {
    auto worker = scene.worker(NERF_OUTPUT_RGB);
    const auto needed = worker->explain({});
    CHECK(needed && *needed > 100);
    std::vector<char> text(*needed);
    char cut[10];
    const nerf::counters work;
    CHECK(worker->explain(text) && std::strlen(text.data()) + 1 == *needed);
    CHECK(worker->explain(cut) && std::strlen(cut) == 9 && std::memcmp(cut, text.data(), 9) == 0);
    const auto more = worker->explain({}, &work);
    CHECK(more && *more > *needed);
}

void pictures_are_drawn_without_a_camera(const nerf::scene &picture, const nerf::scene &scene) {
    CHECK(picture.is_picture() && picture.info().picture_width == 33);
    std::vector<std::uint8_t> rgb(3 * pixels), tiled(3 * pixels);
    nerf::target target;
    target.rgb = nerf::plane::rgb_u8(rgb);
    auto worker = picture.worker(target.outputs());
    const auto whole = worker->render_picture(width, height, target);
    CHECK(whole && whole->colour_evaluations == pixels);
    target.rgb = nerf::plane::rgb_u8(tiled);
    const nerf::tiles tiles{width, height, 30};
    int calls = 0;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
        CHECK(worker->render_picture(width, height, target, tiles[i], [&calls] { ++calls; }));
    }
    CHECK(rgb == tiled && calls > 4);
    CHECK(worker->render(camera_of(scene), target).status() == NERF_STATUS_NOT_A_SCENE);
    CHECK(scene.worker(target.outputs())->render_picture(width, height, target).status() == NERF_STATUS_NOT_A_PICTURE);
}

} // namespace

int main(int argc, char **argv) {
    if (argc != 5) {
        return 2;
    }
    CHECK(nerf::abi_matches() && nerf::version() == nerf_version_text() && !nerf::version().empty());
    CHECK(std::strcmp(nerf::error{}.text(), nerf_status_text(NERF_STATUS_OK)) == 0);
    const std::vector<char> blob = read(argv[2]), with_front = read(argv[1]);
    views_are_made_of_what_lies_side_by_side();
    memory_is_owned_or_lent_and_moves();
    scenes_open_in_any_memory(blob, argv[2], argv[4]);
    what_was_moved_from_is_empty(argv[2]);
    const auto front = nerf::scene::open(with_front), plain = nerf::scene::open(blob);
    const auto picture = nerf::scene::open_file(argv[3]);
    if (!front || !plain || !picture) {
        std::fprintf(stderr, "%s %s %s\n", front.error().text(), plain.error().text(), picture.error().text());
        return 3;
    }
    cameras_look_where_they_are_told(*plain);
    targets_may_be_any_shape(*plain);
    progress_may_be_any_callable_and_cancels_whole_tiles(*plain);
    effects_and_settings_reach_the_frame(*plain);
    points_can_be_asked(*plain);
    rays_are_a_host_s_own(*plain);
    one_ray_in_one_call_is_one_of_many(*plain);
    fields_stand_where_a_host_puts_them(*plain);
    quality_has_a_price(*front, *plain);
    frames_explain_themselves(*plain);
    pictures_are_drawn_without_a_camera(*picture, *plain);
    return failures == 0 ? 0 : 1;
}
