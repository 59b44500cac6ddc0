//! Inline forms of KRL: folds whose lines the controller writes again when somebody changes the form.

use crate::robot_programs::correction::source::Source;

/// First words of the lines by which an inline form prepares its motion.
const PREPARING: [&str; 6] = [
    "$bwdstart",
    "bas",
    "fdat_act",
    "ldat_act",
    "pdat_act",
    "set_cd_params",
];

/// Returns the first byte of the inline form around the motion at a byte, and the lines by which it prepares the motion. `None`
/// for a motion that something else precedes in its fold.
pub fn inline_form(source: &Source, motion: usize) -> Option<(usize, Vec<Vec<u8>>)> {
    let mut preparing = Vec::new();
    let mut nested = 0_usize;
    let mut end = source.line_start(motion);
    while end > 0 {
        let start = source.line_start(end - 1);
        let line = source.slice(&(start..end)).trim_ascii();
        let text = String::from_utf8_lossy(line).to_ascii_lowercase();
        let word: String = (text.chars())
            .take_while(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '$'))
            .collect();
        if text.starts_with(";fold") {
            if nested == 0 {
                preparing.reverse();
                let blanks = source.slice(&(start..end));
                let blanks = blanks.iter().take_while(|b| b.is_ascii_whitespace());
                return Some((start + blanks.count(), preparing));
            }
            nested -= 1;
        } else if text.starts_with(";endfold") {
            nested += 1;
        } else if nested == 0 && PREPARING.contains(&word.as_str()) {
            preparing.push(line.to_vec());
        } else if !text.is_empty() && !text.starts_with(';') {
            return None;
        }
        end = start;
    }
    None
}
