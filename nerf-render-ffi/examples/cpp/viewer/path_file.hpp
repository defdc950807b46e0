// Views as a camera path: nerfstudio's camera_path.json, which `nerf-train render --path` reads.
#ifndef VIEWER_PATH_FILE_HPP
#define VIEWER_PATH_FILE_HPP

#include "nerf_render.hpp"

#include <cmath>
#include <cstdio>
#include <fstream>
#include <locale>
#include <sstream>
#include <string>
#include <vector>

namespace path_file {

/// Frames a second.
constexpr int fps = 24;

/// The file of at least one view; all have the first one's size.
inline std::string text(const std::vector<nerf::camera> &views) {
    std::ostringstream json;
    json.imbue(std::locale::classic());
    json.precision(9);
    const nerf::camera &first = views.front();
    json << "{\"camera_type\": \"perspective\", \"render_width\": " << first.width
         << ", \"render_height\": " << first.height << ", \"fps\": " << fps << ", \"seconds\": "
         << static_cast<double>(views.size()) / fps << ", \"camera_path\": [";
    for (const nerf::camera &view : views) {
        const double height = static_cast<double>(view.height);
        const double fov = 2.0 * std::atan(0.5 * height / static_cast<double>(view.fy)) * 180.0 / 3.14159265358979;
        json << (&view == &first ? "\n" : ",\n") << "  {\"camera_to_world\": [";
        for (const float number : view.c2w) {
            json << number << ", ";
        }
        json << "0, 0, 0, 1], \"fov\": " << fov << ", \"aspect\": " << static_cast<double>(view.width) / height << '}';
    }
    json << "\n]}\n";
    return json.str();
}

/// Writes it whole or not at all.
inline bool write(const std::string &path, const std::vector<nerf::camera> &views) {
    const std::string beside = path + ".part";
    std::ofstream file(beside, std::ios::binary | std::ios::trunc);
    file << text(views);
    file.close();
    if (file && std::rename(beside.c_str(), path.c_str()) == 0) {
        return true;
    }
    std::remove(beside.c_str());
    return false;
}

} // namespace path_file

#endif // VIEWER_PATH_FILE_HPP
