//! Programs that embed the library: C, C++, Python, a browser, a microcontroller. Tests cover their images, their
//! packages, and their memory accesses under sanitizers.

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
