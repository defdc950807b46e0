//! The report of `nerf_explain`, through the C interface.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::Status;
use nerf_testing::call::{self, Message, Opened};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::Recipe;
use std::ptr::{null, null_mut};

const RGB: u32 = ffi::NERF_OUTPUT_RGB;

/// Writes the report to `page`. Returns the status and the size of the uncut text, bytes.
fn explain(
    opened: &Opened,
    options: Option<&ffi::RenderOptions>,
    outputs: u32,
    counters: Option<&ffi::Counters>,
    page: &mut Guarded,
) -> (Status, usize) {
    let (mut needed, mut message) = (usize::MAX, Message::default());
    let options = options.map_or(null(), |options| options as *const _);
    let counters = counters.map_or(null(), |counters| counters as *const _);
    let (at, size, text) = (page.at().cast(), page.size(), message.0.as_mut_ptr());
    // SAFETY: everything lives until the call returns.
    let status =
        unsafe { call::explain(opened.scene, options, outputs, counters, at, size, &mut needed, text, 256) };
    assert_eq!(message.text().is_empty(), status == Status::Ok);
    (status, needed)
}

fn text(page: &Guarded) -> &str {
    let end = page.bytes().iter().position(|&byte| byte == 0).expect("a NUL");
    std::str::from_utf8(&page.bytes()[..end]).expect("UTF-8")
}

#[test]
fn a_text_fits_the_size_it_names_and_is_cut_below() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let none = null_mut();
    let mut needed = 0;
    // SAFETY: the scene is intact; a size may be asked for without a text.
    let status =
        unsafe { call::explain(opened.scene, null(), RGB, null(), none, 0, &mut needed, null_mut(), 0) };
    assert_eq!(status, Status::Ok);
    let mut page = Guarded::new(needed, 0);
    assert_eq!(explain(&opened, None, RGB, None, &mut page), (Status::Ok, needed));
    let whole = text(&page).to_owned();
    assert!(whole.len() + 1 == needed && page.surroundings_are_intact());
    for word in
        ["occupancy          on, 8x8x8", "off: absent in the scene", "off: not asked for", "workspace"]
    {
        assert!(whole.contains(word), "{word}: {whole}");
    }
    let bytes = opened.workspace(None, RGB).size();
    assert!(whole.contains(&format!("{bytes} bytes")), "{whole}");
    for size in [1, 2, 100, needed - 1] {
        let mut page = Guarded::new(size, 0);
        assert_eq!(explain(&opened, None, RGB, None, &mut page), (Status::Ok, needed));
        assert_eq!(text(&page), &whole[..size - 1]);
        assert!(page.surroundings_are_intact());
    }
}

#[test]
fn counters_add_where_the_work_went_and_wrong_arguments_write_nothing() {
    let opened = call::open(Recipe::PLAIN.blob(), Kernel::IN_PLACE);
    let mut counters = call::counters();
    (counters.rays, counters.macs, counters.density_evaluations) = (10, u64::MAX, u64::MAX);
    let mut page = Guarded::new(4096, 0);
    let exact = call::render_options();
    assert_eq!(explain(&opened, Some(&exact), RGB, Some(&counters), &mut page).0, Status::Ok);
    assert!(text(&page).contains("rays               10"));
    assert!(text(&page).contains("colour cut         off: switched off by the request"), "{}", text(&page));

    let mut page = Guarded::new(4096, 0);
    let mut wrong = call::render_options();
    wrong.colour_cut = 1.0;
    assert_eq!(explain(&opened, Some(&wrong), RGB, None, &mut page), (Status::Options, usize::MAX));
    assert_eq!(explain(&opened, None, 64, None, &mut page), (Status::Options, usize::MAX));
    counters.struct_size = 1;
    assert_eq!(explain(&opened, None, RGB, Some(&counters), &mut page).0, Status::StructSize);
    assert!(page.is_untouched());
}
