//! Pareto front of another study, read from its points.csv.

use crate::measure::point::Clock;
use crate::show::plot::{Marker, Series};
use std::path::Path;

/// Reads a Pareto front, named after its folder, from the points.csv at `path`: PSNR over wall or CPU seconds per view.
pub fn front_of(path: &Path, clock: Clock) -> anyhow::Result<Series> {
    let refused = |found: String| {
        anyhow::anyhow!("--beside: {}: expected the points.csv of a study, found {found}", path.display())
    };
    let mut table = csv::Reader::from_path(path).map_err(|e| refused(e.to_string()))?;
    let seconds = if clock == Clock::Wall { "wall_s_median" } else { "cpu_s_median" };
    let header = table.headers().map_err(|e| refused(e.to_string()))?.clone();
    let place = |name: &str| {
        header.iter().position(|found| found == name).ok_or_else(|| refused(format!("no column {name}")))
    };
    let (on_front, time, loss) = (place("on_front")?, place("relative_time")?, place("loss_db")?);
    let (psnr, seconds) = (place("psnr_db")?, place(seconds)?);
    // `exact`: seconds and PSNR of the exact rendering, which is the first row.
    let (mut exact, mut points) = (None, Vec::new());
    for (row, cells) in table.records().enumerate() {
        let cells = cells.map_err(|e| refused(e.to_string()))?;
        let number = |column: usize| {
            let found = cells.get(column).unwrap_or_default();
            let value: Result<f64, _> = found.parse();
            value.map_err(|_| refused(format!("{found:?} in line {}, column {}", row + 2, &header[column])))
        };
        let (seconds_of_exact, psnr_of_exact) = match exact {
            Some(exact) => exact,
            None => *exact.insert((number(seconds)?, number(psnr)?)),
        };
        if &cells[on_front] == "true" {
            points.push((number(time)? * seconds_of_exact, psnr_of_exact - number(loss)?));
        }
    }
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let name = path.parent().and_then(Path::file_name).unwrap_or(path.as_os_str());
    Ok(Series { name: format!("front of {}", name.to_string_lossy()), points, marker: Marker::LineAndPoints })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the Pareto front of a points.csv with the content `text`, in a folder named `classic`.
    fn read(text: &str, clock: Clock) -> anyhow::Result<Series> {
        let folder = tempfile::tempdir().expect("a folder");
        let table = folder.path().join("classic/points.csv");
        std::fs::create_dir(folder.path().join("classic")).expect("a folder");
        std::fs::write(&table, text).expect("a file");
        front_of(&table, clock)
    }

    #[test]
    fn a_front_is_read_as_it_was_drawn() {
        let table = "label,psnr_db,loss_db,wall_s_median,cpu_s_median,relative_time,on_front\n\
                     exact,30.0,0.0,2.0,3.0,1.0,true\n\
                     base,30.5,-0.5,1.0,1.5,0.5,true\n\
                     poor,20.0,10.0,1.0,1.5,0.6,false\n";
        let front = read(table, Clock::Wall).expect("a front");
        assert_eq!(front.name, "front of classic");
        assert_eq!(front.points, [(1.0, 30.5), (2.0, 30.0)]);
        assert_eq!(read(table, Clock::Cpu).expect("a front").points, [(1.5, 30.5), (3.0, 30.0)]);
    }

    #[test]
    fn what_is_no_table_of_a_study_is_refused_by_line_and_column() {
        let message = |text| read(text, Clock::Wall).expect_err("no front").to_string();
        assert!(message("label,psnr_db\nexact,1.0\n").contains("no column on_front"));
        let torn = message("psnr_db,loss_db,wall_s_median,relative_time,on_front\n30.0,zero,2.0,1.0,true\n");
        assert!(torn.contains("\"zero\" in line 2, column loss_db"), "{torn}");
        assert!(front_of(Path::new("nowhere/points.csv"), Clock::Wall).is_err());
    }
}
