//! Colours in text form.

const NAMED: [(&str, [f32; 3]); 3] = [("black", [0.0; 3]), ("white", [1.0; 3]), ("red", [1.0, 0.0, 0.0])];

/// Parses `black`, `white`, `red`, `R,G,B` with channels 0 to 255, or `#RRGGBB` into display-encoded values in `0..=1`.
pub fn parse(text: &str) -> Result<[f32; 3], String> {
    if let Some((_, colour)) = NAMED.into_iter().find(|(name, _)| *name == text) {
        return Ok(colour);
    }
    let hex = text.strip_prefix('#').filter(|hex| hex.len() == 6 && !hex.starts_with('+'));
    if let Some(rgb) = hex.and_then(|hex| u32::from_str_radix(hex, 16).ok()) {
        return Ok([16, 8, 0].map(|shift| (rgb >> shift & 255) as f32 / 255.0));
    }
    let channels: Option<Vec<f32>> =
        text.split(',').map(|c| c.trim().parse::<u8>().ok().map(|c| f32::from(c) / 255.0)).collect();
    let channels: Option<[f32; 3]> = channels.and_then(|channels| channels.try_into().ok());
    channels.ok_or_else(|| "expected black, white, red, #RRGGBB, or R,G,B with channels from 0 to 255".into())
}

pub fn name(colour: [f32; 3]) -> String {
    match NAMED.into_iter().find(|(_, named)| *named == colour) {
        Some((name, _)) => name.into(),
        None => colour.map(|c| (c * 255.0).round().to_string()).join(","),
    }
}
