//! Multiresolution grid of features (Müller et al. 2022), as `nerf-core/docs/blob-format.md` specifies it.

/// Shape and tables of a grid.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Number of features per entry.
    pub features: usize,
    /// Binary logarithm of the number of hash values of a hashed level.
    pub log2_entries: u32,
    /// Number of cells along each axis, `[levels][axes]`; 2 or 3 axes.
    pub resolutions: Vec<Vec<u64>>,
    /// Features of all entries of all levels, `[entries][features]`.
    pub values: Vec<f64>,
}

/// An encoded value, and the magnitude of the entries that were interpolated, which limits the rounding error.
#[derive(Clone, Copy, Debug)]
pub struct Value {
    /// Interpolated value.
    pub value: f64,
    /// Largest absolute value among the interpolated entries.
    pub largest: f64,
}

impl Grid {
    /// Returns the number of entries of a level, and whether the level is hashed.
    pub fn entries(&self, level: usize) -> (u64, bool) {
        let vertices: u64 = self.resolutions[level].iter().map(|n| n + 1).product();
        let most = 1 << self.log2_entries;
        if vertices <= most { (vertices, false) } else { (most + self.resolutions[level][0], true) }
    }

    fn entry(&self, level: usize, vertex: &[u64]) -> u64 {
        let (cells, z) = (&self.resolutions[level], vertex.get(2).copied().unwrap_or(0));
        if !self.entries(level).1 {
            return (z * (cells[1] + 1) + vertex[1]) * (cells[0] + 1) + vertex[0];
        }
        let product = |x: u64, factor: u64| x * factor % (1 << 32);
        let h = product(vertex[1], 2_654_435_761) ^ product(z, 805_459_861);
        (h ^ (h >> 15)) % (1 << self.log2_entries) + vertex[0]
    }

    /// Returns the encoding of a point whose coordinates run from 0 to 1 across the box.
    pub fn encode(&self, unit: &[f64]) -> Vec<Value> {
        let mut out = Vec::new();
        let mut first = 0;
        for (level, cells) in self.resolutions.iter().enumerate() {
            let places: Vec<(u64, f64)> = unit
                .iter()
                .zip(cells)
                .map(|(&u, &n)| {
                    let g = u.clamp(0.0, 1.0) * n as f64;
                    let cell = (g.floor() as u64).min(n - 1);
                    (cell, g - cell as f64)
                })
                .collect();
            for feature in 0..self.features {
                let (mut value, mut largest) = (0.0, 0.0f64);
                for corner in 0..1usize << unit.len() {
                    let far = |axis: usize| corner >> axis & 1;
                    let vertex: Vec<u64> =
                        places.iter().enumerate().map(|(axis, (cell, _))| cell + far(axis) as u64).collect();
                    let weight: f64 = places
                        .iter()
                        .enumerate()
                        .map(|(axis, (_, w))| if far(axis) == 1 { *w } else { 1.0 - w })
                        .product();
                    let at = (first + self.entry(level, &vertex)) as usize * self.features + feature;
                    value += weight * self.values[at];
                    largest = largest.max(self.values[at].abs());
                }
                out.push(Value { value, largest });
            }
            first += self.entries(level).0;
        }
        out
    }
}
