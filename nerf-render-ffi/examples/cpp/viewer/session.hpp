// Order of drawing: cheap frames while the camera moves, better frames while the camera rests.
#ifndef VIEWER_SESSION_HPP
#define VIEWER_SESSION_HPP

#include "orbit.hpp"
#include "painter.hpp"
#include "picture.hpp"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

struct Settings {
    unsigned threads = 1;
    float moving_ms = 60.0f;    // what a frame may take while the camera moves
    float resting_ms = 3000.0f; // and the first of full size, once it rests
    std::optional<nerf::vec3> up; // where not the scene's own
};

/// Settings of a frame, with the expected time and loss.
struct Plan {
    nerf::options options;
    std::uint32_t divisor = 1;     // of the window's sides
    double milliseconds = 0.0;     // foreseen; 0 where nothing is known yet
    std::optional<float> loss_db;  // by the scene's front
};

/// Facts about a frame that ended.
struct Report {
    Plan plan;
    nerf::camera camera;
    Outcome outcome;
    bool moving;
};

class Session {
public:
    /// Measures the pace of the scene's front, if the scene has one. error() describes a failure.
    Session(const nerf::scene &scene, const Settings &settings, std::uint32_t width, std::uint32_t height);

    Orbit orbit; // after a change: moved()

    /// Chosen views, of the window's size: the keyframes of a camera path.
    std::vector<nerf::camera> views;
    /// Adds the present view to `views`.
    void choose() { views.push_back(orbit.camera(width_, height_)); }

    /// Tells that the camera moved: a frame for a resting camera is cancelled, within a tile.
    void moved();
    /// Tells that the camera rests: quality may rise.
    void rest() { resting_ = true; }
    void resize(std::uint32_t width, std::uint32_t height);
    void show(View view);
    View view() const { return view_; }

    /// Copies finished tiles into the display and begins the next frame. Returns whether the display changed.
    bool update();
    /// Whether there is nothing to draw until the next input.
    bool done();
    /// Waits until the frame that is being drawn ends.
    void wait() { painter_.wait(); }
    /// For scripts: cancels the next frame of full size after `tiles` tiles.
    void interrupt_after(std::size_t tiles) { stop_after_ = tiles; }

    std::uint32_t width() const { return width_; }
    std::uint32_t height() const { return height_; }
    const std::vector<std::uint8_t> &display() const { return display_; } // width x height, RGB
    const std::string &error() const { return error_; }
    std::uint32_t samples() const { return scene_.info().samples; }
    /// The name of the data that the scene was trained on.
    std::string_view data() const { return nerf::view(scene_.info().data); }

    /// Called for each frame that ends.
    std::function<void(const Report &)> on_frame;

private:
    // Stages of one view, each better than the stage before: while the camera moves; in few pixels still; in all
    // pixels; and without a visible loss.
    static constexpr int moving = 0, better = 1, full = 2, finest = 3;

    Plan within(float budget, bool full_size) const;
    Plan plan(int stage) const;
    void begin(int stage);
    void end();
    void learn(const Report &report);
    void develop(const nerf::rect &tile);

    const nerf::scene &scene_;
    Settings settings_;
    std::uint32_t width_, height_;
    View view_ = View::colour;
    std::vector<std::uint8_t> display_;
    Picture picture_;
    std::string error_;

    std::optional<nerf::pace> pace_; // of all threads together
    double pace_pixels_ = 1.0;       // of the frame it was measured for
    // Measurements of earlier frames, for each view.
    struct Known {
        double slowness = 1.0;     // of this machine now, against the pace
        double us_per_pixel = 0.0; // without a front; 0 before the first frame
    } known_[3];

    int stage_ = moving, drawn_ = -1; // what is begun, what is on the display
    Plan plan_, drawn_plan_;
    nerf::camera camera_;
    bool running_ = false, dirty_ = true, resting_ = false;
    std::size_t stop_after_ = std::numeric_limits<std::size_t>::max();

    Painter painter_; // last: it stops before what it draws into ends
};

#endif // VIEWER_SESSION_HPP
