//! Report of an audit.

use crate::measure::audit::Audit;
use crate::show::table::Table;

pub fn table(audit: &Audit) -> Table {
    let columns =
        ["effect", "in its place", "with, dB", "without, dB", "gains, dB", "time", "MACs", "verdict"];
    let mut table = Table::new(columns);
    for (effect, worth) in audit {
        match worth {
            Ok(worth) => table.push([
                effect.name.to_owned(),
                effect.instead.to_owned(),
                format!("{:.3}", worth.with_db),
                format!("{:.3}", worth.without_db),
                format!("{:.3}", worth.gain_db()),
                format!("{:.3}", worth.relative_time),
                format!("{:.4}", worth.relative_macs),
                worth.verdict.name().to_owned(),
            ]),
            Err(why) => table.push([effect.name, effect.instead, "–", "–", "–", "–", "–", why]),
        };
    }
    table
}
