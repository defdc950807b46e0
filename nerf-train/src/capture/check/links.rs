//! Graph of the photographs that share points: its connected components (pieces), and its bridges.

use super::pairs::Pair;
use crate::capture::sights::Sights;
use std::collections::BTreeMap;

/// Minimum number of common points that link two photographs. A pair that agrees ([`Pair::agrees`]) is also linked.
const LINKED: u32 = 15;
/// Maximum number of photographs that one point links to each other; further photographs of the point are ignored.
const MAX_TRACK: usize = 200;

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Links {
    /// Connected components, as indices of photographs, the largest first.
    pub pieces: Vec<Vec<usize>>,
    /// Links whose removal would split a connected component, each with the number of photographs in the smaller part.
    pub bridges: Vec<([usize; 2], usize)>,
}

/// State of a depth-first search through all links.
struct Search<'l> {
    linked: &'l [Vec<usize>],
    /// Order in which each photograph was reached, from 1; 0 if it was not reached yet.
    reached: Vec<usize>,
    found: Vec<usize>,
    bridges: Vec<([usize; 2], usize)>,
}

impl Search<'_> {
    /// Searches depth-first from `view`, without the link to `parent`. Returns its low-link: the smallest `reached` of
    /// `view`, of its descendants in the search tree, and of all photographs linked to one of these.
    ///
    /// # Source
    /// Tarjan 1974, "A note on finding the bridges of a graph".
    fn visit(&mut self, view: usize, parent: Option<usize>) -> usize {
        self.found.push(view);
        self.reached[view] = self.found.len();
        let (mut low, linked) = (self.found.len(), self.linked);
        for &other in linked[view].iter().filter(|other| Some(**other) != parent) {
            if self.reached[other] > 0 {
                low = low.min(self.reached[other]);
                continue;
            }
            let before = self.found.len();
            let lowest = self.visit(other, Some(view));
            if lowest > self.reached[view] {
                self.bridges.push(([view.min(other), view.max(other)], self.found.len() - before));
            }
            low = low.min(lowest);
        }
        low
    }
}

impl Links {
    /// Links photographs that share at least [`LINKED`] points or form a pair that agrees; finds pieces and bridges.
    pub fn of(sights: &Sights, pairs: &[Pair]) -> Self {
        let mut showing: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (view, sights) in sights.of_views.iter().enumerate() {
            sights.iter().for_each(|sight| showing.entry(sight.point).or_default().push(view));
        }
        let mut shared: BTreeMap<[usize; 2], u32> = BTreeMap::new();
        for views in showing.values_mut() {
            views.dedup();
            views.truncate(MAX_TRACK);
            for (i, &a) in views.iter().enumerate() {
                views[i + 1..].iter().for_each(|&b| *shared.entry([a, b]).or_default() += 1);
            }
        }
        for pair in pairs.iter().filter(|pair| pair.agrees()) {
            *shared.entry(pair.views).or_default() += LINKED;
        }
        let mut linked = vec![Vec::new(); sights.of_views.len()];
        for ([a, b], _) in shared.into_iter().filter(|(_, count)| *count >= LINKED) {
            linked[a].push(b);
            linked[b].push(a);
        }
        let reached = vec![0; linked.len()];
        let mut search = Search { linked: &linked, reached, found: Vec::new(), bridges: Vec::new() };
        let (mut pieces, mut bridges) = (Vec::new(), Vec::new());
        for view in 0..linked.len() {
            if search.reached[view] > 0 {
                continue;
            }
            let before = search.found.len();
            search.visit(view, None);
            let mut piece = search.found[before..].to_vec();
            piece.sort_unstable();
            let of = |(link, behind): ([usize; 2], usize)| (link, behind.min(piece.len() - behind));
            bridges.extend(search.bridges.drain(..).map(of));
            pieces.push(piece);
        }
        pieces.sort_by_key(|piece| std::cmp::Reverse(piece.len()));
        bridges.sort_unstable();
        Self { pieces, bridges }
    }
}
