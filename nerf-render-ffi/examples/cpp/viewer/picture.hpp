// Planes of a frame in memory, and their conversion to colours for the display.
#ifndef VIEWER_PICTURE_HPP
#define VIEWER_PICTURE_HPP

#include "nerf_render.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

/// Output that is displayed.
enum class View { colour, z_depth, normals };

/// Planes of one frame; only planes that the view needs have memory.
class Picture {
public:
    /// `nearest`, `farthest`: z_depth at the ends of the colour scale, world units.
    void prepare(View view, std::uint32_t width, std::uint32_t height, float nearest, float farthest) {
        const std::size_t pixels = std::size_t{width} * height;
        view_ = view;
        width_ = width;
        nearest_ = nearest;
        farthest_ = farthest;
        rgb_.resize(view == View::colour ? 3 * pixels : 0);
        values_.resize(view == View::z_depth ? pixels : view == View::normals ? 3 * pixels : 0);
        opacity_.resize(view == View::colour ? 0 : pixels);
    }

    View view() const { return view_; }

    nerf::target target() {
        nerf::target to;
        if (view_ == View::colour) {
            to.rgb = nerf::plane::rgb_u8(rgb_);
            return to;
        }
        to.opacity = nerf::plane::f32(opacity_);
        if (view_ == View::z_depth) {
            to.z_depth = nerf::plane::f32(values_);
        } else {
            to.normals = nerf::plane::vec3_f32(values_);
        }
        return to;
    }

    /// Returns a pixel as 8-bit colour: the rendered colour; z_depth on a scale from near (yellow) to far (violet); or
    /// normals with x, y, z as red, green, blue. z_depth and normals fade to black with opacity.
    std::array<std::uint8_t, 3> pixel(std::uint32_t x, std::uint32_t y) const {
        const std::size_t i = std::size_t{y} * width_ + x;
        std::array<float, 3> colour{};
        switch (view_) {
        case View::colour: return {rgb_[3 * i], rgb_[3 * i + 1], rgb_[3 * i + 2]};
        case View::z_depth: colour = scale((farthest_ - values_[i]) / (farthest_ - nearest_)); break;
        case View::normals:
            for (std::size_t k = 0; k < 3; ++k) {
                colour[k] = 0.5f + 0.5f * values_[3 * i + k];
            }
        }
        std::array<std::uint8_t, 3> bytes{};
        for (std::size_t k = 0; k < 3; ++k) {
            bytes[k] = static_cast<std::uint8_t>(255.0f * std::clamp(colour[k] * opacity_[i], 0.0f, 1.0f) + 0.5f);
        }
        return bytes;
    }

private:
    /// Colour scale: eight points of matplotlib's viridis (CC0), interpolated linearly; 0 is violet, 1 is yellow.
    static std::array<float, 3> scale(float at) {
        static constexpr float points[8][3] = {{0.267f, 0.005f, 0.329f}, {0.275f, 0.195f, 0.496f},
                                               {0.213f, 0.359f, 0.552f}, {0.153f, 0.497f, 0.558f},
                                               {0.122f, 0.633f, 0.531f}, {0.290f, 0.759f, 0.428f},
                                               {0.622f, 0.854f, 0.226f}, {0.993f, 0.906f, 0.144f}};
        const float place = 7.0f * std::clamp(at, 0.0f, 1.0f);
        const int left = std::min(static_cast<int>(place), 6);
        const float share = place - static_cast<float>(left);
        std::array<float, 3> colour{};
        for (std::size_t k = 0; k < 3; ++k) {
            colour[k] = points[left][k] + share * (points[left + 1][k] - points[left][k]);
        }
        return colour;
    }

    View view_ = View::colour;
    std::uint32_t width_ = 0;
    float nearest_ = 0.0f, farthest_ = 1.0f;
    std::vector<std::uint8_t> rgb_;
    std::vector<float> values_, opacity_;
};

#endif // VIEWER_PICTURE_HPP
