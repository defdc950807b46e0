// The two ways to drive a session: a window, and a script.
#ifndef VIEWER_FRONTENDS_HPP
#define VIEWER_FRONTENDS_HPP

#include "session.hpp"

#include <string>

/// Writes the display as PNG, or as PPM if `path` ends in .ppm.
bool write_screenshot(const Session &session, const std::string &path);

/// Writes the chosen views as a camera path.
bool write_path(const Session &session, const std::string &path);

/// Returns a line about a frame, for people and for tests: names and numbers.
std::string line_about(const Report &report);

/// Runs the commands of a script without a window. Returns the program's exit code.
int run_script(Session &session, const std::string &script);

/// Shows a window until it is closed. `screenshot`, `path`: files that the keys `s` and `p` write.
int run_window(Session &session, const std::string &title, const std::string &screenshot, const std::string &path);

#endif // VIEWER_FRONTENDS_HPP
