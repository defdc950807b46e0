# find_package(nerf_render 2 CONFIG REQUIRED) gives
#
#   nerf_render::nerf_render   the shared library; where only the static one is installed, that
#   nerf_render::static        the static library, with what it needs of the system
#
# Lies in PREFIX/share/cmake/nerf_render and holds no path: a prefix may move, and its libraries may lie in lib,
# lib64 or a directory of the architecture.
get_filename_component(_nerf_render_prefix "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)
set(_nerf_render_include "${_nerf_render_prefix}/include")

set(_nerf_render_shared "")
set(_nerf_render_static "")
foreach(_nerf_render_lib IN ITEMS "lib/${CMAKE_LIBRARY_ARCHITECTURE}" lib64 lib)
    set(_nerf_render_lib "${_nerf_render_prefix}/${_nerf_render_lib}/libnerf_render")
    if(NOT _nerf_render_shared AND EXISTS "${_nerf_render_lib}${CMAKE_SHARED_LIBRARY_SUFFIX}")
        set(_nerf_render_shared "${_nerf_render_lib}${CMAKE_SHARED_LIBRARY_SUFFIX}")
    endif()
    if(NOT _nerf_render_static AND EXISTS "${_nerf_render_lib}.a")
        set(_nerf_render_static "${_nerf_render_lib}.a")
    endif()
endforeach()

if(NOT EXISTS "${_nerf_render_include}/nerf_render.h" OR NOT (_nerf_render_shared OR _nerf_render_static))
    set(nerf_render_FOUND FALSE)
    set(nerf_render_NOT_FOUND_MESSAGE
        "expected include/nerf_render.h and a library in lib, lib64 or lib/ARCHITECTURE under ${_nerf_render_prefix}")
    return()
endif()

if(_nerf_render_static AND NOT TARGET nerf_render::static)
    add_library(nerf_render::static STATIC IMPORTED)
    set_target_properties(nerf_render::static PROPERTIES
        IMPORTED_LOCATION "${_nerf_render_static}"
        IMPORTED_LINK_INTERFACE_LANGUAGES C
        INTERFACE_INCLUDE_DIRECTORIES "${_nerf_render_include}"
        INTERFACE_LINK_LIBRARIES "-lpthread;-ldl;-lm")
endif()
if(NOT TARGET nerf_render::nerf_render)
    if(_nerf_render_shared)
        add_library(nerf_render::nerf_render SHARED IMPORTED)
        set_target_properties(nerf_render::nerf_render PROPERTIES
            IMPORTED_LOCATION "${_nerf_render_shared}"
            INTERFACE_INCLUDE_DIRECTORIES "${_nerf_render_include}")
    else()
        add_library(nerf_render::nerf_render INTERFACE IMPORTED)
        set_target_properties(nerf_render::nerf_render PROPERTIES INTERFACE_LINK_LIBRARIES nerf_render::static)
    endif()
endif()
