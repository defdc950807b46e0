use super::*;

#[test]
fn occupancy_takes_at_most_a_third_of_the_tables() {
    let mut config = Preset::Grid.config();
    let tables = |config: &Config, extent| {
        let grid = config.network.grid.as_ref().expect("a grid");
        2.0 * grid.encoding(extent).values() as f32
    };
    let bits = |resolution: u16, extent: Vec3| {
        (extent / extent.max_element() * f32::from(resolution)).round().element_product() / 8.0
    };
    let mut found = Vec::new();
    for log2_entries in [16, 14, 13, 12, 11, 10] {
        config.network.grid.as_mut().expect("a grid").log2_entries = log2_entries;
        for extent in [Vec3::ONE, Vec3::new(1.5, 2.5, 1.8), Vec3::new(4.0, 4.0, 0.1)] {
            let resolution = config.occupancy_resolution(extent);
            let budget = tables(&config, extent) / 3.0;
            assert!(bits(resolution, extent) <= budget, "2^{log2_entries}, {extent}: {resolution}");
            // The next finer candidate resolution takes more than a third of the bytes of the tables.
            if let Some(i) = OCCUPANCY_RESOLUTIONS.iter().position(|&r| r == resolution).filter(|&i| i > 0) {
                assert!(bits(OCCUPANCY_RESOLUTIONS[i - 1], extent) > budget, "2^{log2_entries}, {extent}");
            }
            found.push(resolution);
        }
    }
    found.sort_unstable();
    found.dedup();
    assert!(found.len() >= 3, "{found:?} proves little");
    config.occupancy.resolution = 77;
    assert_eq!(config.occupancy_resolution(Vec3::ONE), 77, "what was asked for");
}
