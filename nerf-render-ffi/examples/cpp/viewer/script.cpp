// A session without a window, driven by commands instead of mouse and keys.
//
//     turn DX DY      drag: over the image's height; draws the frame of the moving camera
//     pan DX DY       drag with the right button, over the same height
//     dolly STEPS     the wheel
//     size W H        a window of another size
//     view NAME       colour, z_depth or normals
//     interrupt N     lets the picture become better, and stops the first frame of full size after N tiles
//     rest            lets the picture become as good as it gets
//     shot FILE       writes what the window would show
//     key             chooses the present view
//     path FILE       writes the chosen views as a camera path (nerf-train render --path)
#include "../image_files.hpp"
#include "frontends.hpp"
#include "path_file.hpp"

#include <algorithm>
#include <iostream>
#include <sstream>

namespace {

// Runs the loop of a window until there is nothing more to do.
void settle(Session &session) {
    do {
        session.wait();
        session.update();
    } while (!session.done());
}

// Returns the rest of a command without spaces around: a file's name, which may contain spaces.
std::string rest_of(std::istream &command) {
    std::string text;
    std::getline(command >> std::ws, text);
    return text.erase(text.find_last_not_of(" \t\r") + 1);
}

bool run(Session &session, std::istream &command) {
    std::string name;
    command >> name;
    float x = 0.0f, y = 0.0f;
    std::uint32_t width = 0, height = 0;
    std::size_t tiles = 0;
    std::string text;
    if (name == "turn" && command >> x >> y) {
        session.orbit.turn(x, y);
        session.moved();
    } else if (name == "pan" && command >> x >> y) {
        session.orbit.pan(x, y);
        session.moved();
    } else if (name == "dolly" && command >> x) {
        session.orbit.dolly(x);
        session.moved();
    } else if (name == "size" && command >> width >> height && std::min(width, height) > 0) {
        session.resize(width, height);
    } else if (name == "view" && command >> text && (text == "colour" || text == "z_depth" || text == "normals")) {
        session.show(text == "colour" ? View::colour : text == "z_depth" ? View::z_depth : View::normals);
    } else if (name == "interrupt" && command >> tiles) {
        session.interrupt_after(tiles);
        session.rest();
    } else if (name == "rest") {
        session.rest();
    } else if (name == "shot" && !(text = rest_of(command)).empty()) {
        return write_screenshot(session, text);
    } else if (name == "key") {
        session.choose();
        return true;
    } else if (name == "path" && !(text = rest_of(command)).empty()) {
        return write_path(session, text);
    } else {
        std::cerr << "viewer: --script: expected a command and its arguments, found \"" << name << "\"\n";
        return false;
    }
    settle(session);
    return true;
}

} // namespace

bool write_screenshot(const Session &session, const std::string &path) {
    const bool ppm = path.size() > 4 && path.compare(path.size() - 4, 4, ".ppm") == 0;
    const std::uint32_t width = session.width(), height = session.height();
    const bool written = image_files::write(path, ppm ? image_files::pnm(width, height, session.display())
                                                      : image_files::png_rgb8(width, height, session.display()));
    if (!written) {
        std::cerr << "viewer: cannot write " << path << '\n';
    }
    return written;
}

bool write_path(const Session &session, const std::string &path) {
    if (session.views.empty()) {
        std::cerr << "viewer: " << path << ": expected at least one view to be chosen (key), found none\n";
        return false;
    }
    const bool written = path_file::write(path, session.views, path_file::origin_in(session.data()));
    if (!written) {
        std::cerr << "viewer: cannot write " << path << '\n';
    }
    return written;
}

std::string line_about(const Report &report) {
    const nerf::options &options = report.plan.options;
    std::ostringstream line;
    line.precision(9);
    line << (report.moving ? "moving " : "resting ") << (report.outcome.complete ? "complete" : "cancelled") << " size "
         << report.camera.width << ' ' << report.camera.height << " divisor " << report.plan.divisor << " samples "
         << options.samples << " transmittance_cut " << options.transmittance_cut << " colour_cut "
         << options.colour_cut << " ignore_occupancy " << options.ignore_occupancy << " ignore_proposal "
         << options.ignore_proposal << " maths " << options.maths << " macs " << report.outcome.work.macs
         << " foreseen " << report.plan.milliseconds << " took " << report.outcome.milliseconds << " focal "
         << report.camera.fx << " c2w";
    for (const float number : report.camera.c2w) {
        line << ' ' << number;
    }
    return line.str();
}

// Commands end with a semicolon or a line's end.
int run_script(Session &session, const std::string &script) {
    session.on_frame = [](const Report &report) { std::cout << line_about(report) << '\n'; };
    settle(session);
    std::string lines = script;
    std::replace(lines.begin(), lines.end(), ';', '\n');
    std::istringstream all(lines);
    bool good = true;
    for (std::string line; good && std::getline(all, line);) {
        std::istringstream command(line);
        if (!(command >> std::ws).eof()) {
            good = run(session, command);
        }
    }
    if (!session.error().empty()) {
        std::cerr << "viewer: " << session.error() << '\n';
    }
    return good && session.error().empty() ? 0 : 1;
}
