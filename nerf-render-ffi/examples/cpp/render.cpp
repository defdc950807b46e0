// Renders one view of a scene, or a picture, on all cores: threads take tiles.
//
//     render scene.nerf out_prefix [width height [threads]]
//
// Of a scene it writes out_prefix.ppm (8-bit RGB), out_prefix.pfm (float z_depth, world units) and
// out_prefix.pgm (8-bit z_depth, white = near), 200x200 unless told otherwise. The camera looks at the
// middle of the scene box from half way between near and far. Of a picture (a 2D field) it writes
// out_prefix.ppm, in the picture's own size unless told otherwise.
#include "nerf_render.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <iterator>
#include <memory>
#include <mutex>
#include <new>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace {

constexpr std::uint32_t largest_side = 16384;

// Memory at the alignment the library asks for.
class Memory {
public:
    Memory(std::size_t size, std::size_t align)
        : size_(size), align_(std::align_val_t{align}), data_(::operator new(size, align_)) {}
    ~Memory() { ::operator delete(data_, align_); }
    Memory(const Memory &) = delete;
    Memory &operator=(const Memory &) = delete;

    void *data() const { return data_; }
    std::size_t size() const { return size_; }

private:
    std::size_t size_;
    std::align_val_t align_;
    void *data_;
};

// A buffer for the library's messages; throws what they say.
class Message {
public:
    char *text() { return text_; }
    static constexpr std::size_t capacity = 256;

    void check(const std::string &what, nerf_status status) const {
        if (status != NERF_STATUS_OK) {
            const std::string detail = text_[0] == '\0' ? "" : std::string("\n  ") + text_;
            throw std::runtime_error(what + ": " + nerf_status_text(status) + detail);
        }
    }

private:
    char text_[capacity] = {};
};

// A scene with everything it borrows.
class Scene {
public:
    explicit Scene(const std::string &path) : blob_(read(path)) {
        Message message;
        std::size_t size = 0, align = 0;
        message.check(path, nerf_scene_memory(blob_.data(), blob_.size(), nullptr, &size, &align, message.text(),
                                              Message::capacity));
        memory_ = std::make_unique<Memory>(size, align);
        message.check(path, nerf_scene_open(blob_.data(), blob_.size(), nullptr, memory_->data(), size, &scene_,
                                            message.text(), Message::capacity));
    }

    const nerf_scene *get() const { return scene_; }

    nerf_scene_info info() const {
        nerf_scene_info info = {};
        info.struct_size = sizeof info;
        Message().check("scene", nerf_scene_describe(scene_, &info));
        return info;
    }

private:
    static std::vector<char> read(const std::string &path) {
        std::ifstream file(path, std::ios::binary);
        std::vector<char> bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
        if (bytes.empty()) {
            throw std::runtime_error("cannot read " + path);
        }
        return bytes;
    }

    std::vector<char> blob_;
    std::unique_ptr<Memory> memory_;
    const nerf_scene *scene_ = nullptr;
};

struct Image {
    Image(std::uint32_t w, std::uint32_t h, bool deep)
        : width(w), height(h), rgb(std::size_t{3} * w * h), z_depth(deep ? std::size_t{1} * w * h : 0) {}

    std::uint32_t width, height;
    std::vector<unsigned char> rgb;
    std::vector<float> z_depth; // empty for a picture
};

// A camera on an orbit around the scene box, a little above its middle.
nerf_camera orbit(const nerf_scene_info &info, std::uint32_t width, std::uint32_t height) {
    const float radius = 0.5f * (info.near_distance + info.far_distance);
    const float azimuth = 0.6f, elevation = 0.4f;
    const float ca = std::cos(azimuth), sa = std::sin(azimuth);
    const float ce = std::cos(elevation), se = std::sin(elevation);
    const float axes[3][3] = {{ca, -sa * se, sa * ce}, {0.0f, ce, se}, {-sa, -ca * se, ca * ce}};
    nerf_camera camera = {};
    camera.struct_size = sizeof camera;
    camera.width = width;
    camera.height = height;
    camera.fx = camera.fy = 1.2f * static_cast<float>(std::max(width, height));
    camera.cx = 0.5f * static_cast<float>(width);
    camera.cy = 0.5f * static_cast<float>(height);
    for (int i = 0; i < 3; ++i) {
        std::copy(axes[i], axes[i] + 3, camera.c2w + 4 * i);
        camera.c2w[4 * i + 3] = 0.5f * (info.box_min[i] + info.box_max[i]) + radius * axes[i][2];
    }
    return camera;
}

// What is drawn: a scene through a camera, or a picture, which needs none.
struct Subject {
    const nerf_scene *scene;
    const nerf_camera *camera; // null for a picture

    std::unique_ptr<Memory> workspace() const {
        Message message;
        std::size_t size = 0, align = 0;
        const std::uint32_t outputs = NERF_OUTPUT_RGB | NERF_OUTPUT_Z_DEPTH;
        message.check("workspace", camera == nullptr
                                       ? nerf_picture_workspace_size(scene, nullptr, &size, &align, message.text(),
                                                                     Message::capacity)
                                       : nerf_workspace_size(scene, nullptr, outputs, &size, &align, message.text(),
                                                             Message::capacity));
        return std::make_unique<Memory>(size, align);
    }

    void draw(const nerf_rect &rect, Image &image, const Memory &workspace) const {
        // A plane begins with the rectangle's first pixel; its rows are the image's.
        const std::size_t first = std::size_t{rect.y} * image.width + rect.x;
        nerf_target target = {};
        target.struct_size = sizeof target;
        target.rgb.data = image.rgb.data() + 3 * first;
        target.rgb.row_stride = 3 * static_cast<std::ptrdiff_t>(image.width);
        target.rgb.format = NERF_FORMAT_RGB_U8;
        Message message;
        if (camera == nullptr) {
            message.check("render", nerf_render_picture(scene, image.width, image.height, nullptr, &rect, &target,
                                                        workspace.data(), workspace.size(), nullptr, nullptr,
                                                        nullptr, message.text(), Message::capacity));
            return;
        }
        target.z_depth.data = image.z_depth.data() + first;
        target.z_depth.row_stride = static_cast<std::ptrdiff_t>(sizeof(float) * image.width);
        target.z_depth.format = NERF_FORMAT_F32;
        message.check("render", nerf_render(scene, camera, nullptr, &rect, &target, workspace.data(),
                                            workspace.size(), nullptr, nullptr, nullptr, message.text(),
                                            Message::capacity));
    }
};

// One worker: takes tiles until none is left, in a workspace of its own.
void work(const Subject &subject, Image &image, std::atomic<std::uint32_t> &next) {
    constexpr std::uint32_t side = 64;
    const std::unique_ptr<Memory> workspace = subject.workspace();
    const std::uint32_t across = (image.width + side - 1) / side, down = (image.height + side - 1) / side;
    for (std::uint32_t tile = next++; tile < across * down; tile = next++) {
        const std::uint32_t x = tile % across * side, y = tile / across * side;
        subject.draw({x, y, std::min(side, image.width - x), std::min(side, image.height - y)}, image, *workspace);
    }
}

void render(const Subject &subject, Image &image, unsigned threads) {
    std::atomic<std::uint32_t> next{0};
    std::mutex mutex;
    std::string error;
    std::vector<std::thread> workers;
    for (unsigned i = 0; i < threads; ++i) {
        workers.emplace_back([&] {
            try {
                work(subject, image, next);
            } catch (const std::exception &e) {
                const std::lock_guard<std::mutex> lock(mutex);
                error = e.what();
            }
        });
    }
    for (std::thread &worker : workers) {
        worker.join();
    }
    if (!error.empty()) {
        throw std::runtime_error(error);
    }
}

void write(const std::string &path, const std::string &header, const void *bytes, std::size_t size) {
    std::ofstream file(path, std::ios::binary);
    file << header;
    file.write(static_cast<const char *>(bytes), static_cast<std::streamsize>(size));
    file.close();
    if (!file) {
        throw std::runtime_error("cannot write " + path);
    }
}

void save(const Image &image, const nerf_scene_info &info, const std::string &prefix) {
    const std::string size = std::to_string(image.width) + " " + std::to_string(image.height) + "\n";
    write(prefix + ".ppm", "P6\n" + size + "255\n", image.rgb.data(), image.rgb.size());
    if (info.kind == NERF_KIND_PICTURE) {
        return;
    }

    std::vector<float> upwards; // PFM begins with the bottom row
    for (std::size_t y = image.height; y-- > 0;) {
        const float *row = image.z_depth.data() + y * image.width;
        upwards.insert(upwards.end(), row, row + image.width);
    }
    const std::uint16_t one = 1;
    const bool little = *reinterpret_cast<const unsigned char *>(&one) == 1;
    write(prefix + ".pfm", "Pf\n" + size + (little ? "-1.0\n" : "1.0\n"), upwards.data(),
          upwards.size() * sizeof(float));

    std::vector<unsigned char> grey;
    for (const float z : image.z_depth) {
        const float brightness = (info.far_distance - z) / (info.far_distance - info.near_distance);
        grey.push_back(static_cast<unsigned char>(255.0f * std::clamp(brightness, 0.0f, 1.0f) + 0.5f));
    }
    write(prefix + ".pgm", "P5\n" + size + "255\n", grey.data(), grey.size());
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
    try {
        const Scene scene(argv[1]);
        const nerf_scene_info info = scene.info();
        const bool picture = info.kind == NERF_KIND_PICTURE;
        const bool own_size = picture && !sized;
        if (own_size && std::max(info.picture_width, info.picture_height) > largest_side) {
            throw std::runtime_error(std::string(argv[1]) + " is large: say a width and height");
        }
        Image image(own_size ? info.picture_width : static_cast<std::uint32_t>(width),
                    own_size ? info.picture_height : static_cast<std::uint32_t>(height), !picture);
        const nerf_camera camera = orbit(info, image.width, image.height);
        render({scene.get(), picture ? nullptr : &camera}, image, static_cast<unsigned>(threads));
        save(image, info, argv[2]);
        if (!picture) {
            std::cout.precision(9);
            std::cout << "c2w";
            for (const float number : camera.c2w) {
                std::cout << ' ' << number;
            }
            std::cout << '\n';
        }
    } catch (const std::exception &error) {
        std::cerr << "render: " << error.what() << '\n';
        return EXIT_FAILURE;
    }
    return EXIT_SUCCESS;
}
