//! Screenshots for the README: a running system in the light and the dark theme.
//!
//! If `PLUMBLINE_PICTURES=1` is set, the test replaces the image files of the README. Otherwise, it
//! saves the same screenshots below the target folder and checks that the README's files exist and
//! have the same size.
use std::{env, fs, path::Path, thread, time::Duration};

use super::{
    browser::Page,
    page::{address, with_cockpit_for_browser},
};

const SIZE: (u32, u32) = (1280, 720);

#[test]
fn readme_screenshots_have_the_size_of_new_ones() {
    let (system, port) = with_cockpit_for_browser("");
    let running = system.start(&[]);
    system.wait_until_running();
    let Some(mut page) = Page::new() else { return };
    let replaces_pictures = env::var_os("PLUMBLINE_PICTURES").is_some();
    if replaces_pictures {
        // The page opens with the history of the last minute, so this history must be full.
        thread::sleep(Duration::from_secs(60));
    }
    for scheme in ["light", "dark"] {
        let url = address(&system, port);
        page.goto(&url, SIZE, scheme, true);
        page.until("plumb.state().kind === 'live' && plumb.data.frames.length > 300 && plumb.drawn()");
        page.wait_for_redraw();
        let picture = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("docs/figures/cockpit-{scheme}.png"));
        let new = page.shot(&format!("readme-{scheme}.png"));
        if replaces_pictures {
            fs::copy(&new, &picture).unwrap();
        }
        assert_eq!(png_size(&fs::read(&picture).unwrap()), SIZE, "{}", picture.display());
        assert_eq!(png_size(&fs::read(&new).unwrap()), SIZE);
    }
    page.assert_clean();
    running.interrupt();
}

/// Returns the width and height that the header of a PNG file declares.
fn png_size(png: &[u8]) -> (u32, u32) {
    assert!(png.starts_with(b"\x89PNG\r\n\x1a\n"));
    let field = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
    (field(16), field(20))
}
