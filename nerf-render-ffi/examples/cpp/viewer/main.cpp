// Interactive viewer: coarse frames while the camera moves, and frames of best quality while the camera rests.
//
//     viewer scene.nerf [options]
//
// Mouse: drag to turn, right button or shift to pan, wheel to come nearer. Keys: d z_depth, n normals, c colour, s
// screenshot, k chooses a view, p writes the chosen views as a camera path, q quit. A scene with a Pareto front
// (nerf-train study) is drawn with the settings of least loss in the time available, any other in fewer pixels.
#include "frontends.hpp"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <iostream>

namespace {

struct Arguments {
    std::string scene, script, screenshot, path;
    std::uint32_t width = 800, height = 600;
    Settings settings;
    bool headless = false;
};

constexpr const char usage[] =
    "usage: viewer scene.nerf [--size WxH] [--threads N] [--moving-ms T] [--resting-ms T] [--up x|y|z]\n"
    "                         [--screenshot FILE.png|ppm] [--path FILE.json] [--headless [--script \"turn 0.1 0; rest; ...\"]]\n"
    "  --moving-ms, --resting-ms  what a frame may take while the camera moves (60), and the first of full size\n"
    "                             once it rests (3000)\n"
    "  --headless                 no window: runs the script, rests, writes the screenshot\n";

// Whether `text` is a whole number from 1 to `most`.
bool number(const char *text, long most, long &into) {
    char *end = nullptr;
    into = std::strtol(text, &end, 10);
    return end != text && *end == '\0' && into >= 1 && into <= most;
}

bool milliseconds(const char *text, float &into) {
    char *end = nullptr;
    into = std::strtof(text, &end);
    return end != text && *end == '\0' && into > 0.0f && into <= 1e6f;
}

bool size(const std::string &text, Arguments &into) {
    const std::size_t cross = text.find('x');
    long width = 0, height = 0;
    if (cross == std::string::npos || !number(text.substr(0, cross).c_str(), 8192, width) ||
        !number(text.c_str() + cross + 1, 8192, height)) {
        return false;
    }
    into.width = static_cast<std::uint32_t>(width);
    into.height = static_cast<std::uint32_t>(height);
    return true;
}

bool up(const std::string &axis, std::optional<nerf::vec3> &into) {
    into = nerf::vec3{axis == "x" ? 1.0f : 0.0f, axis == "y" ? 1.0f : 0.0f, axis == "z" ? 1.0f : 0.0f};
    return axis == "x" || axis == "y" || axis == "z";
}

bool parse(int argc, char **argv, Arguments &into) {
    long threads = static_cast<long>(std::max(1u, std::thread::hardware_concurrency()));
    for (int i = 1; i < argc; ++i) {
        const std::string flag = argv[i];
        if (flag == "--headless") {
            into.headless = true;
            continue;
        }
        if (flag.compare(0, 2, "--") != 0 && into.scene.empty()) {
            into.scene = flag;
            continue;
        }
        const char *const value = i + 1 < argc ? argv[++i] : "";
        const bool good = flag == "--size"          ? size(value, into)
                          : flag == "--threads"     ? number(value, 1024, threads)
                          : flag == "--moving-ms"   ? milliseconds(value, into.settings.moving_ms)
                          : flag == "--resting-ms"  ? milliseconds(value, into.settings.resting_ms)
                          : flag == "--up"          ? up(value, into.settings.up)
                          : flag == "--script"      ? !(into.script = value).empty()
                          : flag == "--screenshot"  ? !(into.screenshot = value).empty()
                          : flag == "--path"        ? !(into.path = value).empty()
                                                    : false;
        if (!good) {
            std::cerr << "viewer: " << flag << ' ' << value << " is not understood\n";
            return false;
        }
    }
    into.settings.threads = static_cast<unsigned>(threads);
    return !into.scene.empty();
}

} // namespace

int main(int argc, char **argv) {
    Arguments arguments;
    if (!parse(argc, argv, arguments)) {
        std::cerr << usage;
        return EXIT_FAILURE;
    }
    const auto scene = nerf::scene::open_file(arguments.scene.c_str());
    if (!scene) {
        std::cerr << "viewer: " << scene.error().text() << '\n';
        return EXIT_FAILURE;
    }
    if (scene->is_picture()) {
        std::cerr << "viewer: " << arguments.scene << ": expected a scene, found a picture (a 2D field)\n";
        return EXIT_FAILURE;
    }
    Session session(*scene, arguments.settings, arguments.width, arguments.height);
    if (!session.error().empty()) {
        std::cerr << "viewer: " << session.error() << '\n';
        return EXIT_FAILURE;
    }
    if (!arguments.headless) {
#ifdef VIEWER_WINDOW
        const std::string shot = arguments.screenshot.empty() ? "viewer.png" : arguments.screenshot;
        const std::string path = arguments.path.empty() ? "camera_path.json" : arguments.path;
        return run_window(session, arguments.scene, shot, path);
#else
        std::cerr << "viewer: built without SDL2: only --headless\n";
        return EXIT_FAILURE;
#endif
    }
    const bool good = run_script(session, arguments.script + "\nrest\n") == 0 &&
                      (arguments.screenshot.empty() || write_screenshot(session, arguments.screenshot)) &&
                      (arguments.path.empty() || write_path(session, arguments.path));
    return good ? EXIT_SUCCESS : EXIT_FAILURE;
}
