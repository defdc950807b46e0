use super::*;
use crate::model::quantise::{Quantised, Rounding, TableStorage, values_of};
use nerf_core::blob::StoredTables;

fn grid() -> GridEncoding {
    let resolutions = [[4, 4, 4], [9, 9, 9], [20, 20, 20]].into_iter().collect();
    GridEncoding { inputs: 3, features: 2, log2_entries: 11, resolutions }
}

fn values(grid: &GridEncoding) -> Vec<f32> {
    (0..grid.values()).map(|i| ((i * 7919 % 1009) as f32 / 504.0 - 1.0).powi(3)).collect()
}

fn stored(grid: &GridEncoding, values: &[f32], most_bytes: Option<usize>, given: &[f32]) -> Quantised {
    Quantised::new(grid, values, Rounding { storage: TableStorage::Coded, most_bytes }, given)
        .expect("finite")
}

fn error(grid: &GridEncoding, values: &[f32], stored: StoredTables<'_>) -> f64 {
    let read = values_of(grid, stored);
    values.iter().zip(&read).map(|(a, b)| f64::from(a - b).powi(2)).sum()
}

#[test]
fn coded_tables_take_as_many_bytes_as_they_may_and_no_more() {
    let grid = grid();
    let values = values(&grid);
    let mut errors = Vec::new();
    for most in [100, 500, 1500, 3000, 4000] {
        let coded = stored(&grid, &values, Some(most), &[]);
        let bytes = coded.stored().bytes().len();
        assert!(bytes <= most && (most == 100 || 10 * bytes > 9 * most), "{most}: {bytes}");
        errors.push(error(&grid, &values, coded.stored()));
    }
    assert!(errors.is_sorted_by(|a, b| a > b), "{errors:?}");
    // If the limit is large enough, the steps are those of int8 storage.
    let roomy = stored(&grid, &values, Some(1 << 20), &[]);
    let int8 = Quantised::new(&grid, &values, TableStorage::Int8, &[]).expect("finite");
    assert_eq!(roomy.stored().scales(), int8.stored().scales());
    assert_eq!(values_of(&grid, roomy.stored()), values_of(&grid, int8.stored()));
    assert!(roomy.stored().bytes().len() < int8.stored().bytes().len());
}

#[test]
fn given_scales_stay_unless_more_bytes_come_of_them_than_there_may_be() {
    let grid = grid();
    let values = values(&grid);
    let given = scales(&grid, &values, Some(3000));
    let of = |coded: &Quantised| -> Vec<f32> {
        let scales = coded.stored().scales().expect("scales").as_chunks().0;
        scales.iter().map(|&scale| f32::from_le_bytes(scale)).collect()
    };
    for most in [None, Some(3000)] {
        assert_eq!(of(&stored(&grid, &values, most, &given)), given);
    }
    let coarser = stored(&grid, &values, Some(2000), &given);
    assert!(coarser.stored().bytes().len() <= 2000);
    let found = of(&coarser);
    let by = found[0] / given[0];
    assert!(by > 1.0 && found.iter().zip(&given).all(|(a, b)| (a / b / by - 1.0).abs() < 1e-5), "{found:?}");
}

#[test]
fn zeros_and_one_large_value_fit_into_few_bytes() {
    let grid = grid();
    let mut values = vec![0.0; grid.values()];
    for large in [0.0, 1e-30, 65_504.0] {
        values[100] = large;
        let coded = stored(&grid, &values, Some(100), &[]);
        assert!(coded.stored().bytes().len() <= 100, "{large}");
    }
}

#[test]
fn values_around_an_occupied_cell_are_kept_and_those_that_no_sample_reads_are_0() {
    let grid = grid();
    let values = vec![1.0; grid.values()];
    // Only cell (2, 5, 0) of 8³ is occupied. It spans 0.25 to 0.375, 0.625 to 0.75 and 0 to 0.125 of the box.
    let mut bits = vec![0; 64];
    let cell: usize = (2 * 8 + 5) * 8;
    bits[cell / 8] |= 1 << (cell % 8);
    let kept = without_unread(&grid, &values, [8; 3], &bits);
    let first = grid.levels().next().expect("a level");
    for z in 0..5u32 {
        for y in 0..5u32 {
            for x in 0..5u32 {
                // The first level has 4 cells per axis. Measured in these cells, the occupied cell spans 1 to 1.5,
                // 2.5 to 3 and 0 to 0.5. The margin for rounding adds the vertices x = 0 and y = 4.
                let inside = (0..=2).contains(&x) && (2..=4).contains(&y) && z <= 1;
                let entry = (first.row(y, z) + x) as usize;
                assert_eq!(kept[2 * entry..2 * entry + 2], [f32::from(u8::from(inside)); 2], "{x} {y} {z}");
            }
        }
    }
    // If all cells are occupied, the dense first two levels keep every entry. If none is, every entry becomes 0.
    let shared = grid.levels().nth(2).expect("three levels").first * 2;
    assert_eq!(without_unread(&grid, &values, [8; 3], &[0xff; 64])[..shared], values[..shared]);
    assert!(without_unread(&grid, &values, [8; 3], &[0; 64]).iter().all(|&value| value == 0.0));
}
