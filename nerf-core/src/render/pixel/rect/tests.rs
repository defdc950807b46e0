extern crate std;

use super::*;
use std::vec;
use std::vec::Vec;

#[test]
fn tiles_cover_a_rectangle_once() {
    for (rect, width, height) in [
        (Rect { x: 3, y: 5, width: 33, height: 17 }, 16, 16),
        (Rect { x: 0, y: 0, width: 1, height: 40 }, 16, 7),
        (Rect { x: 0, y: 0, width: 5, height: 4 }, 0, 0),
        (Rect { x: 0, y: 0, width: 5, height: 4 }, u32::MAX, u32::MAX),
    ] {
        let mut seen = vec![0u8; (rect.width * rect.height) as usize];
        for tile in rect.tiles(width, height) {
            assert!(tile.width > 0 && tile.width <= width.max(1) && tile.height <= height.max(1));
            for y in tile.y..tile.y + tile.height {
                for x in tile.x..tile.x + tile.width {
                    seen[((y - rect.y) * rect.width + x - rect.x) as usize] += 1;
                }
            }
        }
        assert!(seen.iter().all(|&n| n == 1), "{rect:?} {width}x{height}");
    }
    assert_eq!(Rect { x: 9, y: 9, width: 0, height: 3 }.tiles(4, 4).count(), 0);
}

#[test]
fn tiles_at_the_end_of_the_numbers_do_not_wrap() {
    let last = u32::MAX - 2;
    let found: Vec<Rect> = Rect { x: last, y: last, width: 10, height: 1 }.tiles(2, 2).collect();
    // Columns from the largest u32 on are cut off.
    assert_eq!(found, [Rect { x: last, y: last, width: 2, height: 1 }]);
}
