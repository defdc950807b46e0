// Views as a camera path: nerfstudio's camera_path.json, which `nerf-train render --path` and nerfstudio's viewer read.
#ifndef VIEWER_PATH_FILE_HPP
#define VIEWER_PATH_FILE_HPP

#include "nerf_render.hpp"

#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iomanip>
#include <locale>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

namespace path_file {

constexpr int fps = 24;

/// Returns the origin of a blob's coordinates in those of its data. The data's name states an origin other than 0.
inline std::array<double, 3> origin_in(std::string_view name) {
    constexpr std::string_view stated = ", origin at (";
    const std::size_t at = name.rfind(stated);
    if (at == std::string_view::npos) {
        return {};
    }
    std::istringstream numbers(std::string(name.substr(at + stated.size())));
    numbers.imbue(std::locale::classic());
    std::array<double, 3> origin{};
    for (std::size_t i = 0; i < 3; ++i) {
        char behind = '\0';
        numbers >> origin[i] >> behind;
        if (behind != (i < 2 ? ',' : ')')) {
            return {};
        }
    }
    return origin;
}

/// Writes a list of views; `matrix` is the JSON key of a view's pose.
inline void list(std::ostream &json, const char *matrix, const std::vector<nerf::camera> &views,
                 const std::array<double, 3> &origin) {
    for (const nerf::camera &view : views) {
        const double height = static_cast<double>(view.height);
        const double fov = 2.0 * std::atan(0.5 * height / static_cast<double>(view.fy)) * 180.0 / 3.14159265358979;
        json << (&view == &views.front() ? "[\n" : ",\n") << "  {\"" << matrix << "\": [";
        for (std::size_t row = 0; row < 3; ++row) {
            const float *const numbers = view.c2w + 4 * row;
            json << numbers[0] << ", " << numbers[1] << ", " << numbers[2] << ", " << std::setprecision(17)
                 << static_cast<double>(numbers[3]) + origin[row] << ", " << std::setprecision(9);
        }
        json << "0, 0, 0, 1], \"fov\": " << fov << ", \"aspect\": " << static_cast<double>(view.width) / height << '}';
    }
    json << "\n]";
}

/// Returns the file's text for at least one view, in the coordinates of the data. All views have the first one's size.
inline std::string text(const std::vector<nerf::camera> &views, const std::array<double, 3> &origin) {
    std::ostringstream json;
    json.imbue(std::locale::classic());
    json.precision(9);
    const nerf::camera &first = views.front();
    json << "{\"camera_type\": \"perspective\", \"render_width\": " << first.width
         << ", \"render_height\": " << first.height << ", \"fps\": " << fps << ", \"seconds\": "
         << static_cast<double>(views.size()) / fps << ", \"camera_path\": ";
    list(json, "camera_to_world", views, origin);
    json << ", \"keyframes\": "; // what nerfstudio's viewer loads
    list(json, "matrix", views, origin);
    json << "}\n";
    return json.str();
}

/// Writes the file whole or not at all.
inline bool write(const std::string &path, const std::vector<nerf::camera> &views,
                  const std::array<double, 3> &origin) {
    const std::string beside = path + ".part";
    std::ofstream file(beside, std::ios::binary | std::ios::trunc);
    file << text(views, origin);
    file.close();
    if (file && std::rename(beside.c_str(), path.c_str()) == 0) {
        return true;
    }
    std::remove(beside.c_str());
    return false;
}

} // namespace path_file

#endif // VIEWER_PATH_FILE_HPP
