#include "painter.hpp"

#include <algorithm>

Painter::Painter(const nerf::scene &scene, unsigned threads) : scene_(scene) {
    for (unsigned i = 0; i < threads; ++i) {
        threads_.emplace_back([this] { live(); });
    }
}

Painter::~Painter() {
    cancel();
    {
        const std::lock_guard<std::mutex> lock(mutex_);
        quitting_ = true;
    }
    changed_.notify_all();
    for (std::thread &thread : threads_) {
        thread.join();
    }
}

void Painter::start(const Frame &frame) {
    const nerf::tiles all{frame.camera.width, frame.camera.height, tile_side};
    std::vector<nerf::rect> tiles;
    for (std::size_t i = 0; i < all.size(); ++i) {
        tiles.push_back(all[i]);
    }
    // Tiles in the middle are drawn first: the viewer looks there.
    const auto from_middle = [&](const nerf::rect &tile) {
        const double x = tile.x + 0.5 * tile.width - 0.5 * frame.camera.width;
        const double y = tile.y + 0.5 * tile.height - 0.5 * frame.camera.height;
        return x * x + y * y;
    };
    std::stable_sort(tiles.begin(), tiles.end(), [&](const nerf::rect &a, const nerf::rect &b) {
        return from_middle(a) < from_middle(b);
    });
    {
        const std::lock_guard<std::mutex> lock(mutex_);
        frame_ = frame;
        tiles_ = std::move(tiles);
        finished_.clear();
        tiles_done_ = 0;
        outcome_ = Outcome();
        next_ = 0;
        cancelled_ = frame.stop_after == 0;
        running_ = threads_.size();
        ++generation_;
        begun_ = Clock::now();
    }
    changed_.notify_all();
}

bool Painter::idle() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return running_ == 0;
}

void Painter::wait() {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return running_ == 0; });
}

std::vector<nerf::rect> Painter::finished() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return std::exchange(finished_, {});
}

double Painter::milliseconds_so_far() const {
    return std::chrono::duration<double, std::milli>(Clock::now() - begun_).count();
}

void Painter::live() {
    nerf::memory home;
    std::uint64_t seen = 0;
    for (;;) {
        {
            std::unique_lock<std::mutex> lock(mutex_);
            changed_.wait(lock, [&] { return quitting_ || generation_ != seen; });
            if (quitting_) {
                return;
            }
            seen = generation_;
        }
        draw(home);
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            if (--running_ == 0) {
                outcome_.complete = tiles_done_ == tiles_.size();
                outcome_.milliseconds = milliseconds_so_far();
            }
        }
        changed_.notify_all();
    }
}

// Frame and tiles do not change while any thread draws, and are read without a lock.
void Painter::draw(nerf::memory &home) {
    const auto fail = [this](const nerf::error &error) {
        const std::lock_guard<std::mutex> lock(mutex_);
        outcome_.error = error;
        cancel();
    };
    const auto needed = scene_.worker_layout(frame_.target.outputs(), frame_.options);
    if (!needed) {
        return fail(needed.error());
    }
    if (home.size() < needed->size) {
        auto larger = nerf::memory::allocate(*needed);
        if (!larger) {
            return fail(larger.error());
        }
        home = std::move(*larger);
    }
    // The memory is reused from frame to frame, whatever the settings.
    const nerf::span bytes(static_cast<unsigned char *>(home.data()), home.size());
    auto worker = scene_.worker(frame_.target.outputs(), frame_.options, nerf::memory::lend(bytes));
    if (!worker) {
        return fail(worker.error());
    }
    for (std::size_t i = next_++; i < tiles_.size() && !cancelled_; i = next_++) {
        const auto done = worker->render(frame_.camera, frame_.target, tiles_[i], [this] { return !cancelled_; });
        if (!done && done.status() != NERF_STATUS_CANCELLED) {
            return fail(done.error());
        }
        if (done) {
            const std::lock_guard<std::mutex> lock(mutex_);
            outcome_.work += *done;
            finished_.push_back(tiles_[i]);
            if (++tiles_done_ >= frame_.stop_after) {
                cancel();
            }
        }
    }
}
