//! Programs that embed the library: C, C++, Python, a browser, a microcontroller; what they link, and who watches them.

mod baseline;
mod c;
mod cpp;
mod element;
mod firmware;
mod header;
mod packages;
mod python;
mod renderers;
mod tools;
mod watched;
mod web;
