// Renders radiance fields from C++17. The header wraps nerf_render.h: memory frees itself, views know their length, and
// errors are values. Nothing here throws, and -fno-exceptions -fno-rtti is fine. Header only.
//
//     auto scene = nerf::scene::open_file("scene.nerf");
//     if (!scene) return complain(scene.error().text());
//     auto camera = scene->start_camera(640, 480, 0.7f);
//
//     std::vector<std::uint8_t> pixels(640 * 480 * 3);
//     nerf::target target;
//     target.rgb = nerf::plane::rgb_u8(pixels);
//     auto worker = scene->worker(target.outputs());
//     if (!worker) return complain(worker.error().text());
//     auto counters = worker->render(camera, target);
//
// - Names, units and rules are those of nerf_render.h. Wrappers of C structures set struct_size.
// - A matrix passed to a function is 16 floats, column-major as in OpenGL and glTF, as the name of the parameter says.
//   The fields c2w and to_world are three rows of four, row-major, as in C.
// - nerf::memory is owned, or lent by the caller: a program without a heap lends all memory.
// - A scene never changes: threads may share it, each with a worker of its own.
// - A moved-from object is empty: calls on it return NERF_STATUS_NULL_POINTER; they are not undefined.
#ifndef NERF_RENDER_HPP
#define NERF_RENDER_HPP

#include "nerf_render.h"

#include <algorithm>
#include <cassert>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <limits>
#include <memory>
#include <new>
#include <optional>
#include <string_view>
#include <type_traits>
#include <utility>

namespace nerf {

// ---------------------------------------------------------------------------------------- views

namespace detail {

/// Type of a container's elements, const if the elements are const.
template <class C>
using element = std::remove_pointer_t<decltype(std::data(std::declval<C &>()))>;

/// True if a span or strided view may refer to the elements of a container passed as C &&. False for a temporary, which
/// frees its elements. Wrongly true for a temporary of const elements, such as a std::initializer_list.
template <class C>
inline constexpr bool lends = std::is_lvalue_reference_v<C> || std::is_same_v<element<C>, element<const C>>;

/// Base class that distinguishes strided views from containers.
struct strided_view {};

/// Casts the address of a structure of floats to a pointer to the first float.
template <class T>
T *floats_at(std::conditional_t<std::is_const_v<T>, const void, void> *at) noexcept { return static_cast<T *>(at); }

} // namespace detail

/// A view of contiguous elements that the view does not own. Converts from arrays and containers with data and size.
template <class T>
class span {
public:
    constexpr span() noexcept = default;
    constexpr span(T *data, std::size_t size) noexcept : data_(data), size_(size) {}

    template <class C, class E = detail::element<C>,
              class = std::enable_if_t<std::is_convertible_v<E (*)[], T (*)[]> &&
                                       (std::is_const_v<T> || detail::lends<C>)>>
    constexpr span(C &&container) noexcept : data_(std::data(container)), size_(std::size(container)) {}

    constexpr T *data() const noexcept { return data_; }
    constexpr std::size_t size() const noexcept { return size_; }
    constexpr bool empty() const noexcept { return size_ == 0; }
    constexpr T *begin() const noexcept { return data_; }
    constexpr T *end() const noexcept { return data_ + size_; }
    constexpr T &operator[](std::size_t i) const noexcept { return assert(i < size_), data_[i]; }

private:
    T *data_ = nullptr;
    std::size_t size_ = 0;
};

/// View of the bytes of a contiguous container: a scene file in a std::vector<char>, an array in flash, a mapped file.
class bytes {
public:
    constexpr bytes(const void *data, std::size_t size) noexcept : data_(data), size_(size) {}

    template <class C, class E = detail::element<const C>, class = std::enable_if_t<std::is_trivially_copyable_v<E>>>
    constexpr bytes(const C &container) noexcept
        : data_(std::data(container)), size_(std::size(container) * sizeof(E)) {}

    template <class C, class = std::enable_if_t<!detail::lends<C>>>
    bytes(C &&container) = delete;

    constexpr const void *data() const noexcept { return data_; }
    constexpr std::size_t size() const noexcept { return size_; }

private:
    const void *data_;
    std::size_t size_;
};

/// A view of contiguous or strided floats that the view does not own. Each ray or point has `each` floats. Converts
/// from a container of floats, or of trivially copyable structures of `each` floats, such as a host's 3D vectors.
/// nerf::member makes a view of one field of larger structures.
template <class T, std::size_t each>
class strided : detail::strided_view {
public:
    constexpr strided() noexcept = default;
    strided(T *data, std::size_t count, std::size_t stride) noexcept : data_(data), count_(count), stride_(stride) {}

    /// Converts a writable view into a read-only one.
    template <class U, class = std::enable_if_t<std::is_same_v<const U, T>>>
    strided(const strided<U, each> &other) noexcept
        : data_(other.data_), count_(other.count_), stride_(other.stride_), whole_(other.whole_) {}

    template <class C, class E = detail::element<C>,
              class = std::enable_if_t<(std::is_same_v<std::remove_const_t<E>, float> ||
                                        (std::is_trivially_copyable_v<E> && std::is_class_v<E> &&
                                         sizeof(E) == each * sizeof(float) && alignof(E) == alignof(float))) &&
                                       (std::is_const_v<T> || (!std::is_const_v<E> && detail::lends<C>)) &&
                                       !std::is_base_of_v<detail::strided_view, std::decay_t<C>>>>
    strided(C &&container) noexcept
        : data_(detail::floats_at<T>(std::data(container))), count_(std::size(container) * sizeof(E) / (each * sizeof(float))),
          whole_(std::size(container) * sizeof(E) % (each * sizeof(float)) == 0) {}

    T *data() const noexcept { return data_; }
    /// Returns the number of rays or points.
    std::size_t size() const noexcept { return count_; }
    bool empty() const noexcept { return data_ == nullptr; }
    /// Returns the distance from the start of one ray's or point's floats to the next start, bytes; 0 if contiguous.
    std::size_t stride() const noexcept { return stride_; }
    nerf_floats c() const noexcept { return {data_, stride_}; }
    /// Returns whether the view holds exactly `count` rays or points, without floats left over.
    bool holds(std::size_t count) const noexcept { return whole_ && count_ == count; }

private:
    template <class, std::size_t>
    friend class strided;

    T *data_ = nullptr;
    std::size_t count_ = 0;
    std::size_t stride_ = 0;
    bool whole_ = true;
};

/// View of three floats per ray or point: points, directions or colours.
template <class T>
using triples = strided<T, 3>;
template <class T>
using numbers = strided<T, 1>;

/// Returns a view of one field (one or more floats) of a container's structures: `nerf::member(rays, &my_ray::origin)`.
template <class C, class S, class F>
auto member(C &&container, F S::*field) noexcept {
    using element = detail::element<C>;
    using number = std::conditional_t<std::is_const_v<element>, const float, float>;
    static_assert(std::is_trivially_copyable_v<F> && sizeof(F) % sizeof(float) == 0 && alignof(F) == alignof(float));
    static_assert(std::is_const_v<element> || detail::lends<C>, "a temporary takes its memory along");
    auto *const first = std::data(container);
    const std::size_t count = std::size(container);
    return strided<number, sizeof(F) / sizeof(float)>(
        count == 0 ? nullptr : detail::floats_at<number>(std::addressof(first->*field)), count, sizeof(S));
}

/// Returns whether the library has the ABI version that this header was written for.
inline bool abi_matches() noexcept { return nerf_abi_version() == NERF_ABI_VERSION; }
inline std::string_view version() noexcept { return nerf_version_text(); }

/// Returns a view of a text inside a scene file; valid while the file's bytes stay in memory.
inline std::string_view view(const nerf_text &text) noexcept { return {text.data, text.length}; }

// --------------------------------------------------------------------------------------- errors

/// An error: a status, and a sentence about what was expected and found.
struct error {
    nerf_status status = NERF_STATUS_OK;
    char message[256] = {};

    /// Returns the message. If the message is empty, returns the meaning of the status. The result is never null.
    const char *text() const noexcept { return message[0] == '\0' ? nerf_status_text(status) : message; }
};

template <class T>
class result;

/// Result of a call that returns no value: success, or the error that explains the failure.
template <>
class [[nodiscard]] result<void> {
public:
    result(const nerf::error &error = {}) noexcept : error_(error) {}

    explicit operator bool() const noexcept { return error_.status == NERF_STATUS_OK; }
    /// Returns the error; its status is NERF_STATUS_OK after a success.
    const nerf::error &error() const noexcept { return error_; }
    nerf_status status() const noexcept { return error_.status; }

private:
    nerf::error error_;
};

/// A value, or the error that explains why there is no value. Test the result before using the value.
template <class T>
class [[nodiscard]] result : public result<void> {
public:
    result(T &&value) noexcept : value_(std::move(value)) {}
    result(const nerf::error &error) noexcept : result<void>(error) {}

    explicit operator bool() const noexcept { return value_.has_value(); }
    T &operator*() & noexcept { return assert(value_), *value_; }
    const T &operator*() const & noexcept { return assert(value_), *value_; }
    /// Moves the value out of a temporary result: `auto w = *scene.worker(...)`.
    T &&operator*() && noexcept { return assert(value_), std::move(*value_); }
    T &value() & noexcept { return **this; }
    const T &value() const & noexcept { return **this; }
    T &&value() && noexcept { return *std::move(*this); }
    T *operator->() noexcept { return assert(value_), &*value_; }
    const T *operator->() const noexcept { return assert(value_), &*value_; }

private:
    std::optional<T> value_;
};

/// Size and alignment of the memory that a call needs, bytes.
struct layout {
    std::size_t size = 0;
    std::size_t align = 1;
};

namespace detail {

/// Runs a C call, `call(value, message, capacity)`, which writes to `value`; returns the value or the error.
template <class T, class Call>
result<T> checked(T value, Call &&call) noexcept {
    error why;
    why.status = call(value, why.message, sizeof why.message);
    return why.status == NERF_STATUS_OK ? result<T>(std::move(value)) : result<T>(why);
}

/// Runs a C call whose last argument before the message receives the result; returns the result or the error.
template <class T, class Call, class... Arguments>
result<T> made(Call &&call, Arguments... arguments) noexcept {
    return checked(T(), [&](T &to, char *message, std::size_t capacity) {
        return call(arguments..., &to, message, capacity);
    });
}

/// Runs a C call whose last arguments before the message receive a size and an alignment. Returns both, or the error.
template <class Call, class... Arguments>
result<layout> layout_of(Call &&call, Arguments... arguments) noexcept {
    return checked(layout(), [&](layout &to, char *message, std::size_t capacity) {
        return call(arguments..., &to.size, &to.align, message, capacity);
    });
}

/// A structure of the C library with struct_size set and zeros elsewhere.
template <class C>
struct sized : C {
    sized() noexcept : C() { this->struct_size = sizeof(C); }
};

/// A value that is reset to T() when it is moved from.
template <class T>
struct moved {
    T value;

    moved(T of = {}) noexcept : value(of) {}
    moved(moved &&other) noexcept : value(std::exchange(other.value, T())) {}
    moved &operator=(moved &&other) noexcept {
        value = std::exchange(other.value, T());
        return *this;
    }
};

/// Deleter of a std::unique_ptr: calls `end`. The default `end` does nothing, since lent memory is not freed. Functions
/// that allocate set an `end` that frees the memory. A program that calls no such function links no heap functions.
template <class T>
struct ending {
    void (*end)(T *, std::size_t align) noexcept = [](T *, std::size_t) noexcept {};
    std::size_t align = 1;

    void operator()(T *owned) const noexcept { end(owned, align); }
};

/// Type of an omitted callback argument. If `progress` is omitted, nothing is called. If `clock` is omitted, the
/// library's own clock is used.
struct none {};

/// A nerf_progress that calls a C++ callable; noexcept, since C calls it. `user`: address of a pointer to the callable.
template <class F>
int32_t progress(void *user, std::uint64_t done, std::uint64_t all) noexcept {
    F &f = **static_cast<F **>(user);
    const auto call = [&] {
        if constexpr (std::is_invocable_v<F &, std::uint64_t, std::uint64_t>) {
            return f(done, all);
        } else {
            return f();
        }
    };
    if constexpr (std::is_void_v<decltype(call())>) {
        call();
        return 0;
    } else {
        static_assert(std::is_same_v<decltype(call()), bool>, "a progress callback says whether to go on, or nothing");
        return call() ? 0 : 1;
    }
}

template <class F>
std::uint64_t clock(void *user) noexcept { return (**static_cast<F **>(user))(); }

} // namespace detail

// --------------------------------------------------------------------------------------- memory

/// Memory for a scene or a worker: owned and freed by this object, or lent by the caller. Movable.
class memory {
public:
    memory() noexcept = default;

    /// Allocates memory from the heap; NERF_STATUS_OUT_OF_MEMORY if there is not enough.
    static result<memory> allocate(const layout &needed) noexcept {
        const auto free = [](void *data, std::size_t align) noexcept { ::operator delete(data, std::align_val_t{align}); };
        void *const data = ::operator new(needed.size, std::align_val_t{needed.align}, std::nothrow);
        if (data == nullptr) {
            return error{NERF_STATUS_OUT_OF_MEMORY, "memory: the heap has not as much as is needed"};
        }
        return memory(data, needed.size, {free, needed.align});
    }
    /// Allocates memory of the layout that `needed` contains. If `needed` contains an error, returns this error.
    static result<memory> allocate(const result<layout> &needed) noexcept {
        return needed ? allocate(*needed) : result<memory>(needed.error());
    }

    /// Makes an object that refers to a container's memory and never frees it. The container must live, and must not
    /// move, while the memory is used.
    template <class C>
    static memory lend(C &&container) noexcept {
        using element = detail::element<C>;
        static_assert(std::is_trivially_copyable_v<element> && !std::is_const_v<element>);
        static_assert(detail::lends<C>, "a temporary takes its memory along");
        return {std::data(container), std::size(container) * sizeof(element)};
    }

    void *data() const noexcept { return data_.get(); }
    std::size_t size() const noexcept { return size_.value; }

private:
    memory(void *data, std::size_t size, detail::ending<void> end = {}) noexcept : data_(data, end), size_{size} {}

    std::unique_ptr<void, detail::ending<void>> data_;
    detail::moved<std::size_t> size_;
};

// --------------------------------------------------------------------------------------- camera

/// Vector of three floats, with the operations that cameras need.
struct vec3 {
    float x = 0.0f, y = 0.0f, z = 0.0f;

    friend vec3 operator+(vec3 a, vec3 b) noexcept { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
    friend vec3 operator-(vec3 a, vec3 b) noexcept { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
    friend vec3 operator*(float s, vec3 a) noexcept { return {s * a.x, s * a.y, s * a.z}; }
};
static_assert(sizeof(vec3) == 3 * sizeof(float));

inline float dot(vec3 a, vec3 b) noexcept { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline vec3 cross(vec3 a, vec3 b) noexcept {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

namespace detail {

/// Returns two unit vectors perpendicular to the unit vector `up` and to each other, as in nerf-train's orbits.
/// Source: Duff et al. 2017, "Building an orthonormal basis, revisited".
inline std::pair<vec3, vec3> across(vec3 up) noexcept {
    const float sign = std::copysign(1.0f, up.z), a = -1.0f / (sign + up.z), b = up.x * up.y * a;
    return {{1.0f + sign * up.x * up.x * a, sign * b, -sign * up.x}, {b, sign + up.y * up.y * a, -up.y}};
}

inline float to_float(float number) noexcept { return number; }
template <class N>
float to_float(N number) noexcept { return static_cast<float>(number); }

/// Converts a host's vector to a vec3 from fields x, y, z. For a vector without these fields, the overload below reads
/// elements 0, 1, 2. Callers pass 0, an int, as the second argument, so that this overload is preferred if it compiles.
template <class V>
auto to_vec3(const V &of, int) noexcept -> decltype(of.x + of.z, vec3()) {
    return {to_float(of.x), to_float(of.y), to_float(of.z)};
}
template <class V>
vec3 to_vec3(const V &of, long) noexcept { return {to_float(of[0]), to_float(of[1]), to_float(of[2])}; }

} // namespace detail

/// The ray through an image point; `dir` has unit length. Distance along the view axis: z_per_distance * ray distance.
struct ray {
    vec3 origin, dir;
    float z_per_distance = 0.0f;
};

/// A nerf_camera, by default a pinhole camera without lens distortion. The camera looks down -Z; +Y is up, +X is right.
struct camera : detail::sized<nerf_camera> {
    /// Makes a camera at the world's origin, with the principal point in the middle of the image; `focal` in pixels.
    camera(std::uint32_t columns, std::uint32_t rows, float focal) noexcept {
        width = columns;
        height = rows;
        fx = fy = focal;
        cx = 0.5f * static_cast<float>(columns);
        cy = 0.5f * static_cast<float>(rows);
        c2w[0] = c2w[5] = c2w[10] = 1.0f;
    }

    /// Makes a camera at the world's origin. `fov`: field of view from the image's bottom to its top, radians.
    static camera from_vertical_fov(std::uint32_t columns, std::uint32_t rows, float fov) noexcept {
        return {columns, rows, 0.5f * static_cast<float>(rows) / std::tan(0.5f * fov)};
    }

    /// Makes a camera from a renderer's column-major matrices: a world-to-eye rotation and translation, and a
    /// perspective projection along -Z, whose near and far planes are ignored. Other matrices give NERF_STATUS_CAMERA.
    static result<camera> from_matrices(std::uint32_t columns, std::uint32_t rows, span<const float> view_column_major,
                                        span<const float> projection_column_major) noexcept {
        if (view_column_major.size() != 16 || projection_column_major.size() != 16) {
            return error{NERF_STATUS_CAMERA, "from_matrices: expected 16 floats each"};
        }
        const auto near_to = [](float a, float b) { return std::fabs(a - b) <= 1e-4f; };
        const float *const v = view_column_major.data(), *const p = projection_column_major.data();
        const bool perspective = p[3] == 0.0f && p[7] == 0.0f && p[15] == 0.0f && p[11] == -1.0f && p[1] == 0.0f &&
                                 p[4] == 0.0f && p[12] == 0.0f && p[13] == 0.0f && p[0] > 0.0f && p[5] > 0.0f;
        if (!perspective) {
            return error{NERF_STATUS_CAMERA, "projection: expected a perspective one that looks along -Z"};
        }
        const vec3 x{v[0], v[4], v[8]}, y{v[1], v[5], v[9]}, z{v[2], v[6], v[10]};
        const bool rigid = near_to(dot(x, x), 1.0f) && near_to(dot(y, y), 1.0f) && near_to(dot(x, y), 0.0f) &&
                           near_to(dot(cross(x, y), z), 1.0f) && near_to(dot(z, z), 1.0f) && v[3] == 0.0f &&
                           v[7] == 0.0f && v[11] == 0.0f && near_to(v[15], 1.0f);
        if (!rigid) {
            return error{NERF_STATUS_CAMERA, "view: expected a rotation and a translation"};
        }
        const float half_width = 0.5f * static_cast<float>(columns), half_height = 0.5f * static_cast<float>(rows);
        camera made(columns, rows, half_width * p[0]);
        made.fy = half_height * p[5];
        made.cx = half_width * (1.0f - p[8]);
        made.cy = half_height * (1.0f + p[9]);
        for (int row = 0; row < 3; ++row) {
            const float *const r = v + 4 * row;
            std::copy_n(r, 3, made.c2w + 4 * row);
            made.c2w[4 * row + 3] = -(v[12] * r[0] + v[13] * r[1] + v[14] * r[2]);
        }
        return made;
    }

    /// Places the camera at `eye`, looking at `target`; the direction `up` points upwards in the image. If `eye` equals
    /// `target`, or if `up` is 0 or parallel to the view axis, rendering returns NERF_STATUS_CAMERA.
    camera &look_at(vec3 eye, vec3 target, vec3 up = {0.0f, 0.0f, 1.0f}) noexcept {
        if (nerf_camera_look_at(this, &eye.x, &target.x, &up.x, nullptr, 0) != NERF_STATUS_OK) {
            c2w[0] = std::numeric_limits<float>::quiet_NaN();
        }
        return *this;
    }

    /// Places the camera on a sphere around `target`, looking at `target`. `azimuth`: angle around the unit vector
    /// `up`, radians, counterclockwise if seen from the tip of `up`. Azimuth 0 is the direction of the first vector of
    /// detail::across(up): +x if `up` is +z. `elevation`: angle above the plane normal to `up`, radians.
    camera &orbit(vec3 target, float radius, float azimuth, float elevation, vec3 up = {0.0f, 0.0f, 1.0f}) noexcept {
        const auto [side, ahead] = detail::across(up);
        const vec3 flat = std::cos(azimuth) * side + std::sin(azimuth) * ahead;
        return look_at(target + radius * (std::cos(elevation) * flat + std::sin(elevation) * up), target, up);
    }

    /// Computes the ray through image point (x, y), pixels: (0, 0) is the top left corner, (0.5, 0.5) a pixel's centre.
    result<nerf::ray> ray(float x, float y) const noexcept {
        return detail::checked(nerf::ray(), [&](nerf::ray &to, char *message, std::size_t capacity) {
            return nerf_camera_ray(this, x, y, &to.origin.x, &to.dir.x, &to.z_per_distance, message, capacity);
        });
    }

    vec3 right() const noexcept { return {c2w[0], c2w[4], c2w[8]}; }
    vec3 up() const noexcept { return {c2w[1], c2w[5], c2w[9]}; }
    vec3 backward() const noexcept { return {c2w[2], c2w[6], c2w[10]}; }
    vec3 centre() const noexcept { return {c2w[3], c2w[7], c2w[11]}; }
};

/// Converts depth `ndc` in normalised device coordinates to a distance along the view axis, for target::limit_z_depth.
/// Returns infinity at an infinite far plane, and NaN unless the matrix has 16 floats. The projection is as in
/// camera::from_matrices, with depths in [-1, 1] or [0, 1], reversed or not. OpenGL's buffer holds 0.5 * ndc + 0.5.
inline float z_depth(float ndc, span<const float> projection_column_major) noexcept {
    if (projection_column_major.size() != 16) {
        return std::numeric_limits<float>::quiet_NaN();
    }
    const float z = projection_column_major[14] / (ndc + projection_column_major[10]);
    return z > 0.0f ? z : std::numeric_limits<float>::infinity();
}

// -------------------------------------------------------------------------------------- targets

using rect = nerf_rect;

/// Placeholder rectangle that means the whole image.
inline constexpr rect whole{0, 0, std::numeric_limits<std::uint32_t>::max(), std::numeric_limits<std::uint32_t>::max()};

/// An image cut into rectangles of at most side x side pixels (side > 0), row by row.
struct tiles {
    std::uint32_t width, height, side;

    std::size_t size() const noexcept { return std::size_t{count(width)} * count(height); }
    rect operator[](std::size_t i) const noexcept {
        const auto x = static_cast<std::uint32_t>(i % count(width)) * side;
        const auto y = static_cast<std::uint32_t>(i / count(width)) * side;
        return {x, y, width - x < side ? width - x : side, height - y < side ? height - y : side};
    }

private:
    std::uint32_t count(std::uint32_t length) const noexcept { return length / side + (length % side != 0); }
};

/// Strides of a nerf_plane, `row_stride` and `pixel_stride`, bytes.
struct strides {
    std::ptrdiff_t row = 0;
    std::size_t pixel = 0;
};

/// An image plane: the caller's buffer, with one value or vector for each pixel of target::window. target::at checks
/// the buffer's size. An output plane receives one output; an output without a plane is not computed. A plane of limits
/// contains the distances at which rays end.
class plane {
public:
    plane() noexcept = default;

    // Planes for colour, in the formats NERF_FORMAT_RGB_* and NERF_FORMAT_RGBA_*.
    static plane rgb_u8(span<std::uint8_t> s, strides by = {}) noexcept { return {NERF_FORMAT_RGB_U8, s, by}; }
    static plane rgba_u8(span<std::uint8_t> s, strides by = {}) noexcept { return {NERF_FORMAT_RGBA_U8, s, by}; }
    static plane rgb_f32(span<float> s, strides by = {}) noexcept { return {NERF_FORMAT_RGB_F32, s, by}; }
    static plane rgba_f32(span<float> s, strides by = {}) noexcept { return {NERF_FORMAT_RGBA_F32, s, by}; }
    // Planes for opacity and distances (NERF_FORMAT_F32), and for normals (NERF_FORMAT_VEC3_F32).
    static plane f32(span<float> s, strides by = {}) noexcept { return {NERF_FORMAT_F32, s, by}; }
    static plane vec3_f32(span<float> s, strides by = {}) noexcept { return {NERF_FORMAT_VEC3_F32, s, by}; }
    // Plane of limits, an input: the distance at which each pixel's ray ends.
    static plane limit(span<const float> s, strides by = {}) noexcept {
        return {NERF_FORMAT_F32, span<float>(const_cast<float *>(s.data()), s.size()), by};
    }
    // Plane over one field of contiguous structures; the field's size gives the format. One float is an opacity or a
    // distance. Three floats are a colour, or, if `normals` is true, a normal. Four floats are RGBA.
    template <class C, class S, class F>
    static plane member(C &&pixels, F S::*field, bool normals = false) noexcept {
        static_assert(sizeof(F) == 4 || sizeof(F) == 12 || sizeof(F) == 16, "expected one, three or four floats");
        const auto floats = nerf::member(std::forward<C>(pixels), field);
        const nerf_format format = sizeof(F) == 4    ? NERF_FORMAT_F32
                                   : sizeof(F) == 16 ? NERF_FORMAT_RGBA_F32
                                   : normals         ? NERF_FORMAT_VEC3_F32
                                                     : NERF_FORMAT_RGB_F32;
        plane of(format, span<float>(floats.data(), 0), {0, sizeof(S)});
        of.extent_ = floats.size() == 0 ? 0 : (floats.size() - 1) * sizeof(S) + sizeof(F);
        return of;
    }

    /// Returns whether the plane was made from a span, even an empty one; false for a default-constructed plane.
    explicit operator bool() const noexcept { return there_; }

private:
    friend struct target;

    template <class T>
    plane(nerf_format f, span<T> s, strides by) noexcept
        : data_(s.data()), by_(by), format_(f), extent_(s.size() * sizeof(T)), there_(true) {}

    std::size_t pixel_size() const noexcept {
        switch (format_) {
        case NERF_FORMAT_RGB_U8: return 3;
        case NERF_FORMAT_RGBA_U8: case NERF_FORMAT_F32: return 4;
        case NERF_FORMAT_RGBA_F32: return 16;
        default: return 12;
        }
    }

    void *data_ = nullptr;
    strides by_;
    nerf_format format_ = NERF_FORMAT_F32;
    std::size_t extent_ = 0; // bytes of the view
    bool there_ = false;
};

/// Planes of an image, or of the image's rectangle `window`. One call can render all of these pixels or a part. For
/// rays, each plane has one row.
struct target {
    plane rgb = {}, opacity = {}, ray_distance = {}, z_depth = {}, median_distance = {}, normals = {};
    /// Inputs: the distance at which each pixel's ray ends, world units. At most one of these two planes may be set.
    /// nerf::z_depth converts depth-buffer values.
    plane limit_ray_distance = {}, limit_z_depth = {};
    /// Rectangle of the image that the planes hold; an empty rectangle for the whole image.
    rect window = {};

    /// Returns the NERF_OUTPUT_* flags of the planes that were set, or-ed.
    std::uint32_t outputs() const noexcept {
        const auto bit = [](const plane &p, std::uint32_t output) { return p ? output : 0u; };
        return bit(rgb, NERF_OUTPUT_RGB) | bit(opacity, NERF_OUTPUT_OPACITY) |
               bit(ray_distance, NERF_OUTPUT_RAY_DISTANCE) | bit(z_depth, NERF_OUTPUT_Z_DEPTH) |
               bit(median_distance, NERF_OUTPUT_MEDIAN_DISTANCE) | bit(normals, NERF_OUTPUT_NORMALS);
    }

    /// Makes the C target for the rectangle `part` of a width x height image; an error if a plane is too small.
    result<nerf_target> at(const rect &part, std::uint32_t width, std::uint32_t height) const noexcept {
        const rect all = window.width == 0 || window.height == 0 ? rect{0, 0, width, height} : window;
        const auto inside = [](std::uint32_t begin, std::uint32_t length, std::uint32_t from, std::uint32_t all_of) {
            return begin >= from && length <= all_of && begin - from <= all_of - length;
        };
        if (!inside(part.x, part.width, all.x, all.width) || !inside(part.y, part.height, all.y, all.height)) {
            return error{NERF_STATUS_RECT, "rect: expected one inside the target's window"};
        }
        detail::sized<nerf_target> to;
        const std::pair<const plane &, nerf_plane &> planes[] = {
            {rgb, to.rgb}, {opacity, to.opacity}, {ray_distance, to.ray_distance}, {z_depth, to.z_depth},
            {median_distance, to.median_distance}, {normals, to.normals},
            {limit_ray_distance, to.limit_ray_distance}, {limit_z_depth, to.limit_z_depth}};
        for (const auto &[from, into] : planes) {
            if (const error wrong = from ? place(from, part, all, into) : error(); wrong.status != NERF_STATUS_OK) {
                return wrong;
            }
        }
        return result<nerf_target>(std::move(to));
    }

private:
    static error place(const plane &from, const rect &part, const rect &all, nerf_plane &to) noexcept {
        constexpr std::int64_t limit = 1 << 30; // times a 32-bit side it is still a 64-bit number
        const std::size_t size = from.pixel_size();
        to.format = from.format_;
        to.pixel_stride = from.by_.pixel == 0 ? size : from.by_.pixel;
        const std::int64_t step = to.pixel_stride > std::size_t{limit} ? limit + 1 : std::int64_t(to.pixel_stride);
        const std::int64_t row = from.by_.row == 0 ? step * all.width : from.by_.row;
        if (step > limit || (all.height > 1 && (row > limit || row < -limit))) {
            return error{NERF_STATUS_OVERFLOW, "target: expected strides of at most 1 GiB"};
        }
        to.row_stride = static_cast<std::ptrdiff_t>(row);
        if (part.width == 0 || part.height == 0) {
            to.data = from.data_;
            return {};
        }
        const std::int64_t top = row < 0 ? -row * (std::int64_t{all.height} - 1) : 0; // where the window's first row is
        const std::int64_t first = top + row * (part.y - all.y) + step * (part.x - all.x);
        const std::int64_t right = step * (part.width - 1), down = row * (part.height - 1);
        const std::int64_t highest = first + right + (down < 0 ? 0 : down);
        if (from.extent_ < size || std::uint64_t(highest) > from.extent_ - size) {
            return error{NERF_STATUS_MEMORY, "target: a view ends before its last pixel"};
        }
        to.data = static_cast<unsigned char *>(from.data_) + static_cast<std::ptrdiff_t>(first);
        return {};
    }
};

// ------------------------------------------------------------------------------ settings, figures

struct open_options : detail::sized<nerf_open_options> {
    open_options(nerf_kernel with = NERF_KERNEL_AUTO, nerf_storage in = NERF_STORAGE_AUTO) noexcept {
        kernel = with;
        storage = in;
    }
};

/// Options of a frame. Default-constructed options are the defaults: empty cells are skipped, a ray ends once it is
/// nearly opaque, and colours of low weight are not evaluated. There is no visible difference from exact rendering.
struct options : detail::sized<nerf_render_options> {
    /// Makes options without transmittance cut, colour cut and normal blur.
    static options uncut() noexcept {
        options all;
        all.transmittance_cut = all.colour_cut = all.normal_blur = NERF_NONE;
        return all;
    }
};

/// Counts of the work that a call did; += adds up the counts of tiles.
struct counters : detail::sized<nerf_counters> {
    counters &operator+=(const nerf_counters &other) noexcept {
        using work = nerf_counters;
        for (const auto field : {&work::rays, &work::samples_kept, &work::samples_skipped, &work::density_evaluations,
                                 &work::colour_evaluations, &work::macs, &work::invalid_samples,
                                 &work::normal_evaluations, &work::proposal_evaluations}) {
            this->*field += other.*field;
        }
        return *this;
    }
};

using choice = detail::sized<nerf_choice>;

struct pace : detail::sized<nerf_pace> {
    /// Returns the times of a frame if `threads` threads share its tiles: the measured times divided by `threads`.
    pace shared_among(unsigned threads) const noexcept {
        pace all = *this;
        for (float &frame : all.milliseconds) {
            frame /= static_cast<float>(threads);
        }
        return all;
    }
};

// ---------------------------------------------------------------------------------------- scene

class worker;

/// Owner of an opened scene or 2D field and of its memory. Movable. A default-constructed object holds no scene.
class scene {
public:
    scene() noexcept = default;

    static result<layout> memory_layout(bytes blob, const open_options &how = {}) noexcept {
        return detail::layout_of(nerf_scene_memory, blob.data(), blob.size(), &how);
    }

    /// Opens a scene in the memory `home`, lent or owned. `blob`: the file's bytes, unchanged while the scene is used.
    static result<scene> open(bytes blob, memory home, const open_options &how = {}) noexcept {
        scene opened;
        opened.home_ = std::move(home);
        return detail::checked(std::move(opened), [&](scene &to, char *message, std::size_t capacity) {
            const nerf_scene *handle = nullptr;
            const nerf_status status = nerf_scene_open(blob.data(), blob.size(), &how, to.home_.data(), to.home_.size(),
                                                       &handle, message, capacity);
            return to.describe(status, handle);
        });
    }

    /// Opens a scene in memory from the heap. `blob`: the scene file's bytes; must not change while the scene is used.
    static result<scene> open(bytes blob, const open_options &how = {}) noexcept {
        result<memory> home = memory::allocate(memory_layout(blob, how));
        return home ? open(blob, std::move(*home), how) : result<scene>(home.error());
    }

    /// Opens the scene file `path`, in memory that the library owns. The library needs the feature `std`.
    static result<scene> open_file(const char *path, const open_options &how = {}) noexcept {
        return detail::checked(scene(), [&](scene &to, char *message, std::size_t capacity) {
            const nerf_scene *handle = nullptr;
            const nerf_status status = nerf_scene_open_file(path, &how, &handle, message, capacity);
            to.handle_.get_deleter().end = [](const nerf_scene *opened, std::size_t) noexcept { nerf_scene_close(opened); };
            return to.describe(status, handle);
        });
    }

    /// Opens a scene file whose path is a std::string, a std::filesystem::path of char, or another type with c_str().
    template <class P, class = std::enable_if_t<std::is_same_v<decltype(std::declval<const P &>().c_str()), const char *>>>
    static result<scene> open_file(const P &path, const open_options &how = {}) noexcept {
        return open_file(path.c_str(), how);
    }

    /// Returns the handle of the scene for calls of the C library; null if the scene is empty.
    const nerf_scene *get() const noexcept { return handle_.get(); }

    /// Returns the description of the scene; all zeros if the scene is empty.
    const nerf_scene_info &info() const noexcept { return info_.value; }
    bool is_picture() const noexcept { return info().kind == NERF_KIND_PICTURE; }

    /// Returns whether the scene file has a default viewpoint, which is the position of a training camera.
    bool has_viewpoint() const noexcept { return info().up[0] != 0.0f || info().up[1] != 0.0f || info().up[2] != 0.0f; }

    // Default orbit, as in camera::orbit, through the viewpoint. Without a viewpoint the orbit is around the middle of
    // the scene box, with z up and a radius half way between near and far.

    vec3 centre() const noexcept {
        return has_viewpoint() ? vector(info().target) : 0.5f * (vector(info().box_min) + vector(info().box_max));
    }
    vec3 up() const noexcept { return has_viewpoint() ? vector(info().up) : vec3{0.0f, 0.0f, 1.0f}; }
    float orbit_radius() const noexcept {
        return has_viewpoint() ? std::sqrt(dot(eye(), eye())) : 0.5f * (info().near_distance + info().far_distance);
    }
    float start_azimuth() const noexcept {
        const auto [side, ahead] = detail::across(up());
        return has_viewpoint() ? std::atan2(dot(eye(), ahead), dot(eye(), side)) : 0.6f;
    }
    float start_elevation() const noexcept {
        const auto [side, ahead] = detail::across(up());
        const float flat = std::hypot(dot(eye(), ahead), dot(eye(), side));
        return has_viewpoint() ? std::atan2(dot(eye(), up()), flat) : 0.4f;
    }
    /// Makes a camera at the default viewpoint of the scene file, on the default orbit. Without a viewpoint, the camera
    /// is on the orbit at azimuth 0.6 and elevation 0.4. `fov`: field of view from bottom to top, radians.
    camera start_camera(std::uint32_t width, std::uint32_t height, float fov) const noexcept {
        auto start = camera::from_vertical_fov(width, height, fov);
        return start.orbit(centre(), orbit_radius(), start_azimuth(), start_elevation(), up());
    }

    /// Opens a worker of this scene in memory from the heap; each thread needs a worker of its own. `outputs`:
    /// NERF_OUTPUT_* flags of the planes to render, or-ed. For queries: NERF_OUTPUT_RGB if colours are wanted, else 0.
    result<nerf::worker> worker(std::uint32_t outputs, const options &how = {}) const noexcept;
    /// Opens a worker of this scene in the memory `home`, lent or owned, of the layout from worker_layout.
    result<nerf::worker> worker(std::uint32_t outputs, const options &how, memory home) const noexcept;
    result<layout> worker_layout(std::uint32_t outputs, const options &how = {}) const noexcept {
        const auto asked = request<nerf_request>(outputs, how);
        return detail::layout_of(nerf_worker_size, &asked);
    }

    // Choose quality settings and write them to `how`: by loss (dB of PSNR below the exact rendering), cost, time,
    // point of the Pareto front, or preset.

    result<choice> within_loss(float loss_db, options &how) const noexcept {
        return detail::made<choice>(nerf_quality_within_loss, get(), loss_db, &how);
    }
    result<choice> within_cost(float ratio, options &how) const noexcept {
        return detail::made<choice>(nerf_quality_within_cost, get(), ratio, &how);
    }
    result<choice> within_time(float milliseconds, const pace &at, options &how) const noexcept {
        return detail::made<choice>(nerf_quality_within_time, get(), milliseconds, &at, &how);
    }
    result<choice> point(std::uint32_t index, options &how) const noexcept {
        return detail::made<choice>(nerf_quality_point, get(), index, &how);
    }
    result<void> preset(nerf_preset wish, options &how) const noexcept {
        error why;
        why.status = nerf_quality_preset(get(), wish, &how, why.message, sizeof why.message);
        return why;
    }

    result<layout> pace_layout(std::uint32_t outputs, const options &how = {}) const noexcept {
        const auto asked = request<nerf_pace_request>(outputs, how);
        return detail::layout_of(nerf_pace_workspace_size, &asked);
    }
    result<memory> pace_workspace(std::uint32_t outputs, const options &how = {}) const noexcept {
        return memory::allocate(pace_layout(outputs, how));
    }
    /// Measures the time of a frame on this thread for each point of the scene's Pareto front of accuracy and time,
    /// the fastest point first. Measuring ends after the first point that takes more than `limit` milliseconds.
    /// `workspace`: from pace_workspace. `clock`: returns microseconds; if omitted, the library's clock is used.
    template <class F = detail::none>
    result<pace> measure_pace(const nerf_camera &camera, std::uint32_t outputs, float limit, memory &workspace,
                              const options &how = {}, F &&clock = {}) const noexcept {
        auto *callable = std::addressof(clock);
        auto asked = request<nerf_pace_request>(outputs, how);
        asked.camera = &camera;
        asked.limit_milliseconds = limit;
        if constexpr (!std::is_same_v<std::decay_t<F>, detail::none>) {
            asked.clock = detail::clock<std::remove_reference_t<F>>;
            asked.user = &callable;
        }
        return detail::made<pace>(nerf_pace_measure, &asked, workspace.data(), workspace.size());
    }

private:
    template <class Request>
    Request request(std::uint32_t outputs, const options &how) const noexcept {
        detail::sized<Request> asked;
        asked.scene = get();
        asked.options = &how;
        asked.outputs = outputs;
        return asked;
    }
    nerf_status describe(nerf_status opened, const nerf_scene *handle) noexcept {
        handle_.reset(handle);
        info_.value.struct_size = sizeof info_.value;
        return opened == NERF_STATUS_OK ? nerf_scene_describe(handle, &info_.value) : opened;
    }
    static vec3 vector(const float (&of)[3]) noexcept { return {of[0], of[1], of[2]}; }
    /// Returns the vector from `target` to `eye` of nerf_scene_info, world units.
    vec3 eye() const noexcept { return vector(info().eye) - vector(info().target); }

    memory home_;
    std::unique_ptr<const nerf_scene, detail::ending<const nerf_scene>> handle_;
    detail::moved<nerf_scene_info> info_;
};

// --------------------------------------------------------------------------------------- worker

/// A scene placed in a host's world: rotated, scaled uniformly, and moved.
struct instance : detail::sized<nerf_instance> {
    /// Places the scene in its own coordinates, without a transform.
    explicit instance(const nerf::scene &of) noexcept { scene = of.get(); }
    /// Places the scene by a transform from scene to world coordinates: 16 floats with the last row 0, 0, 0, 1. For any
    /// other matrix, such as a row-major translation, opening a worker of the instance gives NERF_STATUS_TRANSFORM.
    instance(const nerf::scene &of, span<const float> column_major) noexcept : instance(of) {
        const float *const m = column_major.data();
        const bool affine = column_major.size() == 16 && m[3] == 0.0f && m[7] == 0.0f && m[11] == 0.0f &&
                            std::fabs(m[15] - 1.0f) <= 1e-4f;
        struct_size = affine ? sizeof(nerf_instance) : 0;
        for (std::size_t i = 0; i < 12 && affine; ++i) {
            to_world[i] = m[i % 4 * 4 + i / 4];
        }
    }
};

/// The host's own rays; see nerf_rays. An empty array becomes NULL. Example (C++20): `{.origins = a, .dirs = b}`.
struct rays {
    triples<const float> origins, dirs;
    numbers<const float> t_min = {}, t_max = {}, random = {};
    std::optional<vec3> axis = {};
};

/// Result of one ray. Outputs that the worker was not opened for are 0, but a worker for colour also gives opacity.
struct pixel {
    /// Colour, premultiplied by opacity and without background: add `(1 - opacity) * background` to composite.
    vec3 rgb;
    float opacity = 0.0f, ray_distance = 0.0f, median_distance = 0.0f;
    vec3 normal;
};
static_assert(offsetof(pixel, opacity) == 3 * sizeof(float));

/// A renderer: scene, options, outputs and memory, set up once for any number of calls. Each thread needs a worker of
/// its own. Movable; the scene must not move while the worker is used.
class worker {
public:
    worker() noexcept = default;

    /// Opens a worker of one or several placed scenes, in memory from the heap; everything else is as in scene::worker.
    static result<worker> open(span<const instance> instances, std::uint32_t outputs, const options &how = {}) noexcept {
        return open_on_heap(request(instances, outputs, how));
    }
    static result<worker> open(span<const instance> instances, std::uint32_t outputs, const options &how,
                               memory home) noexcept {
        return open_in(request(instances, outputs, how), std::move(home));
    }
    static result<layout> memory_layout(span<const instance> instances, std::uint32_t outputs,
                                        const options &how = {}) noexcept {
        return layout_of(request(instances, outputs, how));
    }

    nerf_worker *get() const noexcept { return handle_.value; }

    /// Renders a camera's image, or its rectangle `part`. `progress`: called before the first tile and after each tile,
    /// with (pixels done, all pixels) or no arguments. Returns void or bool (false cancels the render); must not throw.
    template <class F = detail::none>
    result<counters> render(const nerf_camera &camera, const target &to, const rect &part = whole,
                            F &&progress = {}) noexcept {
        detail::sized<nerf_frame> frame;
        frame.camera = &camera;
        return draw(nerf_render, frame, camera.width, camera.height, to, part, progress);
    }

    /// Renders a width x height image of a 2D field, or the image's rectangle `part`; everything else is as in render.
    template <class F = detail::none>
    result<counters> render_picture(std::uint32_t width, std::uint32_t height, const target &to, const rect &part = whole,
                                    F &&progress = {}) noexcept {
        detail::sized<nerf_frame> frame;
        frame.width = width;
        frame.height = height;
        return draw(nerf_render_picture, frame, width, height, to, part, progress);
    }

    /// Renders the host's own rays: pixel i of each plane in `to` belongs to ray i.
    result<counters> render_rays(const rays &of, const target &to) noexcept { return trace(nerf_render_rays, of, to); }

    /// Samples the point on each ray at which a photon collides with the medium. `of.random`: in [0, 1), one per ray.
    result<counters> sample_rays(const rays &of, const target &to) noexcept { return trace(nerf_sample_rays, of, to); }

    /// Renders one ray from `t_min` to `t_max`, with every output of the worker except z_depth. For many rays,
    /// render_rays is faster. `origin` and `dir`: vectors of floats or doubles, with fields x, y, z or three elements.
    template <class V, class W, class N = float, class F = float>
    result<pixel> render_ray(const V &origin, const W &dir, N t_min = 0.0f,
                             F t_max = std::numeric_limits<float>::infinity()) noexcept {
        return trace_one(nerf_render_rays, detail::to_vec3(origin, 0), detail::to_vec3(dir, 0), detail::to_float(t_min),
                         detail::to_float(t_max));
    }

    /// Samples the point on one ray at which a photon collides. `random`: in [0, 1). All else is as in render_ray.
    template <class V, class W, class R, class N = float, class F = float>
    result<pixel> sample_ray(const V &origin, const W &dir, R random, N t_min = 0.0f,
                             F t_max = std::numeric_limits<float>::infinity()) noexcept {
        const float number = detail::to_float(random);
        return trace_one(nerf_sample_rays, detail::to_vec3(origin, 0), detail::to_vec3(dir, 0), detail::to_float(t_min),
                         detail::to_float(t_max), &number);
    }

    /// Evaluates density, per world unit, and colour at points seen along unit directions; writes to `sigma` and `rgb`.
    /// An empty `rgb` requests no colour; `dirs` may then be empty, too.
    result<counters> query(triples<const float> positions, triples<const float> dirs, numbers<float> sigma,
                           triples<float> rgb) noexcept {
        const std::size_t n = sigma.size();
        const bool coloured = !rgb.empty();
        if (!sigma.holds(n) || !positions.holds(n) || (coloured && (!dirs.holds(n) || !rgb.holds(n)))) {
            return error{NERF_STATUS_MEMORY, "query: expected views of one length"};
        }
        detail::sized<nerf_points> asked;
        asked.count = n;
        asked.positions = positions.c();
        asked.dirs = dirs.c();
        asked.sigma = {sigma.data(), sigma.stride(), 0, NERF_FORMAT_F32, 0};
        asked.rgb = {rgb.data(), rgb.stride(), 0, NERF_FORMAT_RGB_F32, 0};
        return detail::made<counters>(nerf_query, get(), &asked);
    }

    /// Writes an English report to `text`, cut to fit: which stages this worker's frames run, and why others do not.
    /// `work`: null, or a frame's counters, to report each stage's work. Returns the uncut text's size with NUL, bytes.
    result<std::size_t> explain(span<char> text, const nerf_counters *work = nullptr) noexcept {
        return detail::made<std::size_t>(nerf_explain, get(), work, text.data(), text.size());
    }

private:
    friend class scene;

    static nerf_request request(span<const instance> instances, std::uint32_t outputs, const options &how) noexcept {
        static_assert(sizeof(instance) == sizeof(nerf_instance));
        detail::sized<nerf_request> asked;
        asked.instances = instances.data();
        asked.instance_count = instances.size();
        asked.options = &how;
        asked.outputs = outputs;
        return asked;
    }
    /// Returns the error of the first instance that was made from an invalid matrix; NERF_STATUS_OK if there is none.
    static error wrong_instance(const nerf_request &asked) noexcept {
        for (std::size_t i = 0; i < asked.instance_count; ++i) {
            if (asked.instances[i].struct_size == 0) {
                error why{NERF_STATUS_TRANSFORM, "instances["};
                constexpr std::string_view wrong = "]: expected a matrix of 16 floats, column-major, last row 0 0 0 1";
                char *const index = why.message + sizeof "instances[" - 1;
                std::copy(wrong.begin(), wrong.end(), std::to_chars(index, index + 20, i).ptr);
                return why;
            }
        }
        return {};
    }
    static result<layout> layout_of(const nerf_request &asked) noexcept {
        const error wrong = wrong_instance(asked);
        return wrong.status == NERF_STATUS_OK ? detail::layout_of(nerf_worker_size, &asked) : result<layout>(wrong);
    }
    static result<worker> open_on_heap(const nerf_request &asked) noexcept {
        result<memory> home = memory::allocate(layout_of(asked));
        return home ? open_in(asked, *std::move(home)) : result<worker>(home.error());
    }
    static result<worker> open_in(const nerf_request &asked, memory home) noexcept {
        if (const error wrong = wrong_instance(asked); wrong.status != NERF_STATUS_OK) {
            return wrong;
        }
        worker opened;
        opened.home_ = std::move(home);
        opened.outputs_.value = asked.outputs;
        return detail::checked(std::move(opened), [&](worker &to, char *message, std::size_t capacity) {
            return nerf_worker_open(&asked, to.home_.data(), to.home_.size(), &to.handle_.value, message, capacity);
        });
    }

    template <class F>
    result<counters> draw(decltype(nerf_render) &call, nerf_frame &frame, std::uint32_t width, std::uint32_t height,
                          const target &to, const rect &part, F &progress) noexcept {
        const bool all = part.width == whole.width && part.height == whole.height;
        const rect asked = all ? rect{0, 0, width, height} : part;
        const result<nerf_target> planes = to.at(asked, width, height);
        if (!planes) {
            return planes.error();
        }
        auto *callable = std::addressof(progress);
        frame.rect = &asked;
        frame.target = &*planes;
        if constexpr (!std::is_same_v<std::decay_t<F>, detail::none>) {
            frame.progress = detail::progress<F>;
            frame.user = &callable;
        }
        return detail::made<counters>(call, get(), &frame);
    }

    result<counters> trace(decltype(nerf_render_rays) &call, const rays &of, const target &to) noexcept {
        const std::size_t n = of.origins.size();
        const auto fits = [n](const auto &view) { return view.empty() || view.holds(n); };
        if (!of.origins.holds(n) || !of.dirs.holds(n) || !fits(of.t_min) || !fits(of.t_max) || !fits(of.random) ||
            n > std::numeric_limits<std::uint32_t>::max()) {
            return error{NERF_STATUS_MEMORY, "rays: expected views of one length, below 2^32"};
        }
        const auto count = static_cast<std::uint32_t>(n);
        const result<nerf_target> planes = to.at({0, 0, count, 1}, count, 1);
        if (!planes) {
            return planes.error();
        }
        detail::sized<nerf_rays> asked;
        asked.count = n;
        asked.origins = of.origins.c();
        asked.dirs = of.dirs.c();
        asked.t_min = of.t_min.c();
        asked.t_max = of.t_max.c();
        asked.random = of.random.c();
        asked.axis = of.axis ? &of.axis->x : nullptr;
        asked.target = &*planes;
        return detail::made<counters>(call, get(), &asked);
    }

    result<pixel> trace_one(decltype(nerf_render_rays) &call, const vec3 &origin, const vec3 &dir, float t_min,
                            float t_max, const float *random = nullptr) noexcept {
        return detail::checked(pixel(), [&](pixel &to, char *message, std::size_t capacity) {
            const auto plane_of = [this](std::uint32_t output, void *at, nerf_format format) {
                return nerf_plane{(outputs_.value & output) != 0 ? at : nullptr, 0, 0, format, 0};
            };
            const bool coloured = (outputs_.value & NERF_OUTPUT_RGB) != 0; // RGBA: the opacity follows the colour
            detail::sized<nerf_target> planes;
            planes.rgb = plane_of(NERF_OUTPUT_RGB, &to, NERF_FORMAT_RGBA_F32);
            planes.opacity = plane_of(coloured ? 0 : NERF_OUTPUT_OPACITY, &to.opacity, NERF_FORMAT_F32);
            planes.ray_distance = plane_of(NERF_OUTPUT_RAY_DISTANCE, &to.ray_distance, NERF_FORMAT_F32);
            planes.median_distance = plane_of(NERF_OUTPUT_MEDIAN_DISTANCE, &to.median_distance, NERF_FORMAT_F32);
            planes.normals = plane_of(NERF_OUTPUT_NORMALS, &to.normal, NERF_FORMAT_VEC3_F32);
            detail::sized<nerf_rays> asked;
            asked.count = 1;
            asked.origins.data = &origin.x;
            asked.dirs.data = &dir.x;
            asked.t_min.data = &t_min;
            asked.t_max.data = &t_max;
            asked.random.data = random;
            asked.target = &planes;
            return call(get(), &asked, nullptr, message, capacity);
        });
    }

    memory home_;
    detail::moved<nerf_worker *> handle_;
    detail::moved<std::uint32_t> outputs_;
};

inline result<worker> scene::worker(std::uint32_t outputs, const options &how) const noexcept {
    return nerf::worker::open_on_heap(request<nerf_request>(outputs, how));
}
inline result<worker> scene::worker(std::uint32_t outputs, const options &how, memory home) const noexcept {
    return nerf::worker::open_in(request<nerf_request>(outputs, how), std::move(home));
}

} // namespace nerf

#endif // NERF_RENDER_HPP
