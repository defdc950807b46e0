// Pictures as files, with nothing but the standard library: PPM, PGM, PFM, and PNG of 8 or 16 bits a channel.
//
// PNGs are not compressed (deflate's "stored" blocks): any reader accepts these files, and no library is needed.
#ifndef IMAGE_FILES_HPP
#define IMAGE_FILES_HPP

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <string>
#include <vector>

namespace image_files {

/// Writes a file. Returns whether all bytes were written.
inline bool write(const std::string &path, const std::string &bytes) {
    std::ofstream file(path, std::ios::binary);
    file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    file.close();
    return static_cast<bool>(file);
}

inline std::string text_of(const void *bytes, std::size_t size) {
    return {static_cast<const char *>(bytes), size};
}

/// Makes a binary PPM (three bytes a pixel) or PGM (one byte a pixel).
inline std::string pnm(std::uint32_t width, std::uint32_t height, const std::vector<std::uint8_t> &pixels) {
    const bool grey = pixels.size() == std::size_t{width} * height;
    return (grey ? "P5\n" : "P6\n") + std::to_string(width) + " " + std::to_string(height) + "\n255\n" +
           text_of(pixels.data(), pixels.size());
}

/// Makes a PFM of one or three floats a pixel, in the machine's byte order; the format begins with the bottom row.
inline std::string pfm(std::uint32_t width, std::uint32_t height, const std::vector<float> &pixels) {
    const std::uint16_t one = 1;
    const bool little = *reinterpret_cast<const unsigned char *>(&one) == 1;
    const std::size_t row = height == 0 ? 0 : pixels.size() / height;
    std::string file = (row == width ? "Pf\n" : "PF\n") + std::to_string(width) + " " + std::to_string(height);
    file += little ? "\n-1.0\n" : "\n1.0\n";
    for (std::size_t y = height; y-- > 0;) {
        file += text_of(pixels.data() + y * row, row * sizeof(float));
    }
    return file;
}

inline std::string big_endian(std::uint32_t number) {
    return {static_cast<char>(number >> 24), static_cast<char>(number >> 16), static_cast<char>(number >> 8),
            static_cast<char>(number)};
}

inline std::uint32_t crc32(const std::string &bytes) {
    static const auto table = [] {
        std::array<std::uint32_t, 256> entries{};
        for (std::uint32_t n = 0; n < 256; ++n) {
            std::uint32_t c = n;
            for (int bit = 0; bit < 8; ++bit) {
                c = (c & 1) != 0 ? 0xedb88320u ^ (c >> 1) : c >> 1;
            }
            entries[n] = c;
        }
        return entries;
    }();
    std::uint32_t c = 0xffffffffu;
    for (const char byte : bytes) {
        c = table[(c ^ static_cast<unsigned char>(byte)) & 0xffu] ^ (c >> 8);
    }
    return ~c;
}

/// zlib's container around stored blocks of at most 65,535 bytes.
inline std::string stored_zlib(const std::string &bytes) {
    std::string stream = "\x78\x01";
    std::size_t at = 0;
    do {
        const std::size_t length = std::min<std::size_t>(bytes.size() - at, 65535);
        const auto low = static_cast<char>(length & 0xff), high = static_cast<char>(length >> 8);
        const bool last = at + length == bytes.size();
        stream += {last ? '\1' : '\0', low, high, static_cast<char>(~low), static_cast<char>(~high)};
        stream.append(bytes, at, length);
        at += length;
    } while (at < bytes.size());
    std::uint32_t a = 1, b = 0; // Adler-32
    for (const char byte : bytes) {
        a = (a + static_cast<unsigned char>(byte)) % 65521;
        b = (b + a) % 65521;
    }
    return stream + big_endian(b << 16 | a);
}

inline std::string png_chunk(const std::string &name, const std::string &content) {
    const std::string named = name + content;
    return big_endian(static_cast<std::uint32_t>(content.size())) + named + big_endian(crc32(named));
}

/// A text inside a PNG: a keyword and its value.
struct Note {
    std::string keyword, text;
};

/// Makes a PNG of rows of `bytes_a_row` bytes; 16-bit samples are big-endian. `colour_type`: 0 is grey, 2 is RGB.
inline std::string png(std::uint32_t width, std::uint32_t height, int bits, int colour_type, const std::string &pixels,
                       const std::vector<Note> &notes = {}) {
    const std::size_t bytes_a_row = height == 0 ? 0 : pixels.size() / height;
    std::string filtered; // each row behind its filter: none
    for (std::size_t y = 0; y < height; ++y) {
        filtered += '\0';
        filtered.append(pixels, y * bytes_a_row, bytes_a_row);
    }
    const std::string header = big_endian(width) + big_endian(height) + static_cast<char>(bits) +
                               static_cast<char>(colour_type) + std::string(3, '\0');
    std::string file = "\x89PNG\r\n\x1a\n" + png_chunk("IHDR", header);
    for (const Note &note : notes) {
        file += png_chunk("tEXt", note.keyword + '\0' + note.text);
    }
    return file + png_chunk("IDAT", stored_zlib(filtered)) + png_chunk("IEND", "");
}

inline std::string png_rgb8(std::uint32_t width, std::uint32_t height, const std::vector<std::uint8_t> &pixels,
                            const std::vector<Note> &notes = {}) {
    return png(width, height, 8, 2, text_of(pixels.data(), pixels.size()), notes);
}

inline std::string png_grey16(std::uint32_t width, std::uint32_t height, const std::vector<std::uint16_t> &pixels,
                              const std::vector<Note> &notes = {}) {
    std::string bytes;
    for (const std::uint16_t pixel : pixels) {
        bytes += {static_cast<char>(pixel >> 8), static_cast<char>(pixel & 0xff)};
    }
    return png(width, height, 16, 0, bytes, notes);
}

} // namespace image_files

#endif // IMAGE_FILES_HPP
