#include "session.hpp"

#include <algorithm>
#include <cmath>

namespace {

constexpr std::uint32_t divisors[] = {1, 2, 3, 4, 6, 8, 12, 16};
constexpr std::uint32_t largest_divisor = 16;

double pixels_of(const nerf::camera &camera) { return double(camera.width) * double(camera.height); }

// Whether two plans draw the same picture. Compares the options that a Pareto front may set.
bool same(const Plan &a, const Plan &b) {
    const nerf::options &x = a.options, &y = b.options;
    return a.divisor == b.divisor && x.samples == y.samples && x.transmittance_cut == y.transmittance_cut &&
           x.colour_cut == y.colour_cut && x.ignore_occupancy == y.ignore_occupancy && x.maths == y.maths &&
           x.ignore_proposal == y.ignore_proposal;
}

} // namespace

Session::Session(const nerf::scene &scene, const Settings &settings, std::uint32_t width, std::uint32_t height)
    : orbit(scene, settings.up), scene_(scene), settings_(settings), width_(width), height_(height),
      display_(std::size_t{3} * width * height), camera_(orbit.camera(width, height)),
      painter_(scene, settings.threads) {
    pace_pixels_ = pixels_of(camera_);
    auto workspace = scene.pace_workspace(NERF_OUTPUT_RGB);
    if (!workspace) {
        error_ = workspace.error().text();
        return;
    }
    const float limit = settings.resting_ms * static_cast<float>(settings.threads);
    const auto measured = scene.measure_pace(camera_, NERF_OUTPUT_RGB, limit, *workspace);
    if (measured) {
        pace_ = measured->shared_among(settings.threads);
    } else if (measured.status() != NERF_STATUS_NO_FRONT) {
        error_ = measured.error().text();
    }
}

void Session::moved() {
    dirty_ = true;
    resting_ = false;
    // A frame of a moving camera is short and goes on, so that the display always shows something new.
    if (running_ && stage_ != moving) {
        painter_.cancel();
    }
}

void Session::resize(std::uint32_t width, std::uint32_t height) {
    painter_.cancel();
    painter_.wait();
    running_ = false;
    width_ = width;
    height_ = height;
    display_.assign(std::size_t{3} * width * height, 0);
    moved();
}

void Session::show(View view) {
    view_ = view;
    moved();
}

// Plans a frame within `budget` milliseconds: first quality falls, by the scene's front, then size.
Plan Session::within(float budget, bool full_size) const {
    Plan plan;
    const double pixels = double(width_) * double(height_);
    if (pace_) {
        const double factor = known_[int(view_)].slowness * pixels / pace_pixels_;
        const auto choice = scene_.within_time(static_cast<float>(budget / factor), *pace_, plan.options);
        if (choice) {
            plan.milliseconds = factor * double(choice->milliseconds);
            plan.loss_db = choice->loss_db;
        }
    } else {
        plan.milliseconds = 1e-3 * known_[int(view_)].us_per_pixel * pixels;
    }
    plan.divisor = largest_divisor;
    for (const std::uint32_t divisor : divisors) {
        const bool known = plan.milliseconds > 0.0;
        if (full_size || (known && plan.milliseconds / (double(divisor) * divisor) <= double(budget))) {
            plan.divisor = divisor;
            break;
        }
    }
    plan.milliseconds /= double(plan.divisor) * plan.divisor;
    return plan;
}

Plan Session::plan(int stage) const {
    switch (stage) {
    case moving: return within(settings_.moving_ms, false);
    case better: return within(std::sqrt(settings_.moving_ms * settings_.resting_ms), false);
    case full: return within(settings_.resting_ms, true);
    default: {
        Plan plan;
        const auto set = scene_.preset(NERF_PRESET_HIGH, plan.options);
        return set ? plan : within(settings_.resting_ms, true);
    }
    }
}

void Session::begin(int stage) {
    const Plan next = plan(stage);
    if (stage == moving) {
        dirty_ = false;
        drawn_ = -1;
    } else if (same(next, drawn_plan_) || (stage == better && same(next, plan(full)))) {
        drawn_ = stage; // it is on the display already, or will soon be
        return;
    }
    stage_ = stage;
    plan_ = next;
    // The same view in fewer pixels.
    const std::uint32_t divisor = plan_.divisor;
    camera_ = orbit.camera(width_, height_);
    camera_.width = (width_ + divisor - 1) / divisor;
    camera_.height = (height_ + divisor - 1) / divisor;
    for (float *const length : {&camera_.fx, &camera_.fy, &camera_.cx, &camera_.cy}) {
        *length /= static_cast<float>(divisor);
    }
    const nerf_scene_info &info = scene_.info();
    float half = 0.0f; // of the scene box's longest edge: what lies in its middle shows the whole scale
    for (int i = 0; i < 3; ++i) {
        half = std::max(half, 0.5f * (info.box_max[i] - info.box_min[i]));
    }
    const float nearest = std::max(orbit.radius() - half, 0.0f), farthest = orbit.radius() + half;
    picture_.prepare(view_, camera_.width, camera_.height, nearest, farthest);
    Frame frame{camera_, plan_.options, picture_.target()};
    if (stage != moving && plan_.divisor == 1) {
        frame.stop_after = std::exchange(stop_after_, std::numeric_limits<std::size_t>::max());
    }
    painter_.start(frame);
    running_ = true;
}

bool Session::update() {
    if (!error_.empty()) {
        return false;
    }
    const bool idle = painter_.idle();
    bool changed = false;
    const std::vector<nerf::rect> tiles = painter_.finished();
    // Coarse frames are shown once complete, frames of full size tile by tile.
    if (running_ && stage_ != moving && plan_.divisor == 1) {
        std::for_each(tiles.begin(), tiles.end(), [this](const nerf::rect &tile) { develop(tile); });
        changed = !tiles.empty();
    }
    if (!idle) {
        const double overrun = 50.0 + 4.0 * double(settings_.moving_ms);
        if (stage_ == moving && plan_.divisor < largest_divisor && painter_.milliseconds_so_far() > overrun) {
            painter_.cancel();
        }
        return changed;
    }
    if (running_) {
        end();
        changed = true;
    }
    if (dirty_) {
        begin(moving);
    } else if (resting_ && drawn_ < finest) {
        begin(drawn_ + 1);
    }
    return changed;
}

bool Session::done() { return !error_.empty() || (!running_ && !dirty_ && (!resting_ || drawn_ == finest)); }

void Session::end() {
    running_ = false;
    const Report report{plan_, camera_, painter_.outcome(), stage_ == moving};
    if (report.outcome.error.status != NERF_STATUS_OK) {
        error_ = report.outcome.error.text();
        return;
    }
    learn(report);
    if (report.outcome.complete) {
        if (report.moving || plan_.divisor != 1) {
            develop({0, 0, width_, height_});
        }
        drawn_ = stage_;
        drawn_plan_ = plan_;
    } else if (report.moving) {
        dirty_ = true; // it took too long: once more, smaller
    } else {
        resting_ = false;
    }
    if (on_frame) {
        on_frame(report);
    }
}

// Learns the time that frames really take: other programs run, and the view changes.
void Session::learn(const Report &report) {
    const double took = report.outcome.milliseconds * (report.outcome.complete ? 1.0 : 2.0);
    if (!report.outcome.complete && !report.moving) {
        return;
    }
    Known &known = known_[int(picture_.view())];
    if (!pace_) {
        const double now = 1e3 * took / pixels_of(report.camera);
        known.us_per_pixel = known.us_per_pixel > 0.0 ? 0.5 * (known.us_per_pixel + now) : now;
    } else if (report.plan.milliseconds > 0.0) {
        const double now = known.slowness * took / report.plan.milliseconds;
        known.slowness = std::clamp(0.5 * (known.slowness + now), 0.25, 16.0);
    }
}

// Copies a part of the picture to the display, unchanged, or magnified with linear interpolation.
void Session::develop(const nerf::rect &part) {
    const float scale = 1.0f / static_cast<float>(plan_.divisor);
    const auto last_x = static_cast<float>(camera_.width - 1), last_y = static_cast<float>(camera_.height - 1);
    for (std::uint32_t y = part.y; y < part.y + part.height; ++y) {
        for (std::uint32_t x = part.x; x < part.x + part.width; ++x) {
            std::uint8_t *const to = display_.data() + 3 * (std::size_t{y} * width_ + x);
            if (plan_.divisor == 1) {
                const auto pixel = picture_.pixel(x, y);
                std::copy(pixel.begin(), pixel.end(), to);
                continue;
            }
            const float u = std::clamp((static_cast<float>(x) + 0.5f) * scale - 0.5f, 0.0f, last_x);
            const float v = std::clamp((static_cast<float>(y) + 0.5f) * scale - 0.5f, 0.0f, last_y);
            const auto left = static_cast<std::uint32_t>(u), top = static_cast<std::uint32_t>(v);
            const std::uint32_t right = std::min(left + 1, camera_.width - 1);
            const std::uint32_t bottom = std::min(top + 1, camera_.height - 1);
            const float s = u - static_cast<float>(left), t = v - static_cast<float>(top);
            const auto a = picture_.pixel(left, top), b = picture_.pixel(right, top);
            const auto c = picture_.pixel(left, bottom), d = picture_.pixel(right, bottom);
            for (std::size_t k = 0; k < 3; ++k) {
                const float above = static_cast<float>(a[k]) + s * static_cast<float>(b[k] - a[k]);
                const float below = static_cast<float>(c[k]) + s * static_cast<float>(d[k] - c[k]);
                to[k] = static_cast<std::uint8_t>(above + t * (below - above) + 0.5f);
            }
        }
    }
}
