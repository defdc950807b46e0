// Position of the camera: on a sphere around a point, moved by drags and the wheel.
#ifndef VIEWER_ORBIT_HPP
#define VIEWER_ORBIT_HPP

#include "nerf_render.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>

class Orbit {
public:
    /// Begins at the scene's viewpoint, as nerf-train's orbits do; without a viewpoint, half way between near and far.
    /// `up`: an axis other than the scene's own.
    Orbit(const nerf::scene &scene, std::optional<nerf::vec3> up) noexcept
        : centre_(scene.centre()), up_(up.value_or(scene.up())), radius_(scene.orbit_radius()),
          azimuth_(up ? 0.6f : scene.start_azimuth()), elevation_(up ? 0.4f : scene.start_elevation()) {}

    nerf::camera camera(std::uint32_t width, std::uint32_t height) const noexcept {
        auto camera = nerf::camera::from_vertical_fov(width, height, fov);
        camera.orbit(centre_, radius_, azimuth_, elevation_, up_);
        return camera;
    }

    float radius() const noexcept { return radius_; }

    /// Turns by a drag `dx`, `dy`, in fractions of the image's height; a whole height is half a turn.
    void turn(float dx, float dy) noexcept {
        constexpr float half_turn = 3.14159265f, steepest = 1.55f;
        azimuth_ -= half_turn * dx;
        elevation_ = std::clamp(elevation_ + half_turn * dy, -steepest, steepest);
    }

    /// Moves the centre so that the scene around the centre follows the mouse.
    void pan(float dx, float dy) noexcept {
        const nerf::camera now = camera(2, 2);
        const float height = 2.0f * radius_ * std::tan(0.5f * fov);
        centre_ = centre_ - (height * dx) * now.right() + (height * dy) * now.up();
    }

    /// Moves towards the centre by steps of the wheel. Nothing nearer than the scene's near distance is visible.
    void dolly(float steps) noexcept { radius_ *= std::pow(0.9f, steps); }

private:
    static constexpr float fov = 0.7f; // radians, bottom to top

    nerf::vec3 centre_, up_;
    float radius_, azimuth_, elevation_;
};

#endif // VIEWER_ORBIT_HPP
