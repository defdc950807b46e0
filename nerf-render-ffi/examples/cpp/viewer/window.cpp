// A session in a window, by SDL2.
#include "frontends.hpp"

#include <SDL.h>

#include <cstdio>
#include <iostream>
#include <memory>

namespace {

// Time without movement after which the camera counts as resting, even if a button is down.
constexpr std::uint32_t rest_after_ms = 150;

struct Deleter {
    void operator()(SDL_Window *window) const { SDL_DestroyWindow(window); }
    void operator()(SDL_Renderer *renderer) const { SDL_DestroyRenderer(renderer); }
    void operator()(SDL_Texture *texture) const { SDL_DestroyTexture(texture); }
};

template <class T>
using Owned = std::unique_ptr<T, Deleter>;

class Window {
public:
    Window(Session &session, const std::string &title, const std::string &screenshot, const std::string &path)
        : session_(session), title_(title), screenshot_(screenshot), path_(path) {}

    bool open() {
        constexpr std::uint32_t flags = SDL_WINDOW_RESIZABLE | SDL_WINDOW_ALLOW_HIGHDPI;
        window_.reset(SDL_CreateWindow(title_.c_str(), SDL_WINDOWPOS_CENTERED, SDL_WINDOWPOS_CENTERED,
                                       static_cast<int>(session_.width()), static_cast<int>(session_.height()), flags));
        renderer_.reset(window_ ? SDL_CreateRenderer(window_.get(), -1, 0) : nullptr);
        return renderer_ && fit();
    }

    void run() {
        session_.on_frame = [this](const Report &report) { tell(report); };
        bool open = true;
        std::uint32_t moved_at = SDL_GetTicks();
        while (open && session_.error().empty()) {
            SDL_Event event;
            // Polls every 10 ms while a frame is drawn, else sleeps until the next event.
            const int patience = session_.done() && resting_ ? -1 : 10;
            bool some = SDL_WaitEventTimeout(&event, patience) == 1;
            for (; some; some = SDL_PollEvent(&event) == 1) {
                open = open && event.type != SDL_QUIT;
                if (handle(event)) {
                    moved_at = SDL_GetTicks();
                    resting_ = false;
                }
            }
            if (!resting_ && SDL_GetTicks() - moved_at > rest_after_ms) {
                resting_ = true;
                session_.rest();
            }
            if (session_.update() || exposed_) {
                present();
            }
        }
    }

private:
    // Fits texture and session to the window's pixels, which are more than its points on a HiDPI screen.
    bool fit() {
        int width = 0, height = 0;
        if (SDL_GetRendererOutputSize(renderer_.get(), &width, &height) != 0 || width < 1 || height < 1) {
            return false;
        }
        const auto columns = static_cast<std::uint32_t>(width), rows = static_cast<std::uint32_t>(height);
        if (texture_ && columns == session_.width() && rows == session_.height()) {
            return true;
        }
        session_.resize(columns, rows);
        texture_.reset(SDL_CreateTexture(renderer_.get(), SDL_PIXELFORMAT_RGB24, SDL_TEXTUREACCESS_STREAMING, width,
                                         height));
        return static_cast<bool>(texture_);
    }

    // Handles an event. Returns whether the camera moved.
    bool handle(const SDL_Event &event) {
        switch (event.type) {
        case SDL_MOUSEMOTION: return drag(event.motion);
        case SDL_MOUSEWHEEL:
            session_.orbit.dolly(event.wheel.preciseY);
            session_.moved();
            return true;
        case SDL_KEYDOWN: return press(event.key.keysym.sym);
        case SDL_WINDOWEVENT:
            exposed_ = true;
            if (event.window.event == SDL_WINDOWEVENT_SIZE_CHANGED) {
                fit();
                return true;
            }
            return false;
        default: return false;
        }
    }

    bool drag(const SDL_MouseMotionEvent &motion) {
        int width = 1, height = 1; // points, as the mouse's are
        SDL_GetWindowSize(window_.get(), &width, &height);
        const float dx = static_cast<float>(motion.xrel) / static_cast<float>(height);
        const float dy = static_cast<float>(motion.yrel) / static_cast<float>(height);
        const bool left = (motion.state & SDL_BUTTON_LMASK) != 0;
        const bool other = (motion.state & (SDL_BUTTON_RMASK | SDL_BUTTON_MMASK)) != 0;
        if (other || (left && (SDL_GetModState() & KMOD_SHIFT) != 0)) {
            session_.orbit.pan(dx, dy);
        } else if (left) {
            session_.orbit.turn(dx, dy);
        } else {
            return false;
        }
        session_.moved();
        return true;
    }

    bool press(SDL_Keycode key) {
        switch (key) {
        case SDLK_c: session_.show(View::colour); return true;
        case SDLK_d: session_.show(session_.view() == View::z_depth ? View::colour : View::z_depth); return true;
        case SDLK_n: session_.show(session_.view() == View::normals ? View::colour : View::normals); return true;
        case SDLK_s:
            if (write_screenshot(session_, screenshot_)) {
                std::cout << screenshot_ << '\n';
            }
            return false;
        case SDLK_k: session_.choose(); return false;
        case SDLK_p:
            if (write_path(session_, path_)) {
                std::cout << path_ << '\n';
            }
            return false;
        case SDLK_q:
        case SDLK_ESCAPE: {
            SDL_Event quit = {};
            quit.type = SDL_QUIT;
            SDL_PushEvent(&quit);
            return false;
        }
        default: return false;
        }
    }

    void present() {
        exposed_ = false;
        SDL_UpdateTexture(texture_.get(), nullptr, session_.display().data(), static_cast<int>(3 * session_.width()));
        SDL_RenderCopy(renderer_.get(), texture_.get(), nullptr, nullptr);
        SDL_RenderPresent(renderer_.get());
    }

    // Shows the settings and the time of a frame in the window's title.
    void tell(const Report &report) {
        char text[256];
        const nerf::options &options = report.plan.options;
        int length = std::snprintf(text, sizeof text, "%s: %ux%u, %.0f ms, %u samples, cuts %.2g %.2g", title_.c_str(),
                                   report.camera.width, report.camera.height, report.outcome.milliseconds,
                                   options.samples == 0 ? samples_ : options.samples,
                                   static_cast<double>(options.transmittance_cut),
                                   static_cast<double>(options.colour_cut));
        if (report.plan.loss_db && length > 0 && static_cast<std::size_t>(length) < sizeof text) {
            std::snprintf(text + length, sizeof text - static_cast<std::size_t>(length), ", %.2f dB lost",
                          static_cast<double>(*report.plan.loss_db));
        }
        SDL_SetWindowTitle(window_.get(), text);
    }

    Session &session_;
    std::string title_, screenshot_, path_;
    std::uint32_t samples_ = session_.samples();
    bool resting_ = false, exposed_ = true;
    Owned<SDL_Window> window_;
    Owned<SDL_Renderer> renderer_;
    Owned<SDL_Texture> texture_;
};

} // namespace

int run_window(Session &session, const std::string &title, const std::string &screenshot, const std::string &path) {
    int status = 1;
    if (SDL_Init(SDL_INIT_VIDEO) == 0) {
        Window window(session, title, screenshot, path);
        if (window.open()) {
            window.run();
            status = 0;
        }
    }
    if (status != 0) {
        std::cerr << "viewer: expected a display (or --headless), found: " << SDL_GetError() << '\n';
    }
    SDL_Quit();
    if (!session.error().empty()) {
        std::cerr << "viewer: " << session.error() << '\n';
        status = 1;
    }
    return status;
}
