// Draws one frame after the other on all cores: threads take tiles, each with a worker of its own.
#ifndef VIEWER_PAINTER_HPP
#define VIEWER_PAINTER_HPP

#include "nerf_render.hpp"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <mutex>
#include <thread>
#include <vector>

/// A frame to draw. The target's memory is borrowed until the painter is idle.
struct Frame {
    nerf::camera camera;
    nerf::options options;
    nerf::target target;
    /// Number of tiles after which the frame cancels itself: for scripts.
    std::size_t stop_after = std::numeric_limits<std::size_t>::max();
};

/// Result of a frame.
struct Outcome {
    nerf::counters work;  // of its finished tiles
    nerf::error error;    // status 0 unless a tile failed
    bool complete = false; // false: cancelled, or failed
    double milliseconds = 0.0;
};

class Painter {
public:
    static constexpr std::uint32_t tile_side = 32;

    Painter(const nerf::scene &scene, unsigned threads);
    ~Painter();
    Painter(const Painter &) = delete;
    Painter &operator=(const Painter &) = delete;

    /// Begins a frame. Only while idle.
    void start(const Frame &frame);

    /// Cancels the frame: each thread stops within 16x16 pixels. Does not wait.
    void cancel() { cancelled_ = true; }

    bool idle();
    void wait();

    /// Returns the tiles finished since the last call: whole tiles, also of a cancelled frame.
    std::vector<nerf::rect> finished();

    /// Outcome of the last frame; only while idle.
    const Outcome &outcome() const { return outcome_; }

    double milliseconds_so_far() const;

private:
    using Clock = std::chrono::steady_clock;

    void live();
    void draw(nerf::memory &home);

    const nerf::scene &scene_;
    std::vector<std::thread> threads_;

    std::mutex mutex_; // of all below but the atomics
    std::condition_variable changed_;
    std::uint64_t generation_ = 0;
    std::size_t running_ = 0;
    bool quitting_ = false;
    Frame frame_{nerf::camera(1, 1, 1.0f), {}, {}};
    std::vector<nerf::rect> tiles_, finished_;
    std::size_t tiles_done_ = 0;
    Outcome outcome_;
    Clock::time_point begun_;

    std::atomic<std::size_t> next_{0};
    std::atomic<bool> cancelled_{false};
};

#endif // VIEWER_PAINTER_HPP
