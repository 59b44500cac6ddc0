//! Several files of one campaign: their rows follow each other in the order of the files.

use std::path::Path;

use crate::import::write::{FIRST_LINE, Row};
use poegp_calibration::input_error::InputError;

/// The rows of one file.
pub struct Part<'a> {
    /// Path of the file.
    pub path: &'a Path,
    /// The file.
    pub bytes: &'a [u8],
    /// Rows in the order of the file.
    pub rows: Vec<Row>,
}

/// Gives the rows of a file a session with the name of the file, without its extension.
///
/// # Errors
/// [`InputError`] if the rows have sessions already.
pub fn name_session(part: &mut Part<'_>) -> Result<(), InputError> {
    if let Some(row) = part.rows.iter().find(|row| row.session.is_some()) {
        let session = row.session.clone().unwrap_or_default();
        let found = format!("session {session:?}");
        let expected = "rows without a session, for --session-per-file";
        return Err(InputError::new(part.path, found, expected).at_line(row.line));
    }
    let name = part.path.file_stem().unwrap_or_default();
    let name = name.to_string_lossy().into_owned();
    (part.rows.iter_mut()).for_each(|row| row.session = Some(name.clone()));
    Ok(())
}

/// Joins the rows of `parts`.
///
/// # Errors
/// [`InputError`] if a file is given twice, has other columns than the first, begins before the file in front of it ends, or, if
/// `is_session_per_file`, has the name of another one.
pub fn join(parts: Vec<Part<'_>>, is_session_per_file: bool) -> Result<Vec<Row>, InputError> {
    let names = |row: &Row| -> Vec<String> { row.fields().into_iter().map(|f| f.0).collect() };
    for (k, part) in parts.iter().enumerate().skip(1) {
        let earlier = &parts[..k];
        if let Some(same) = earlier.iter().find(|other| other.bytes == part.bytes) {
            let found = format!("the same bytes as in {}", same.path.display());
            return Err(InputError::new(part.path, found, "another file"));
        }
        if let (Some(first), Some(own)) = (parts[0].rows.first(), part.rows.first()) {
            check_columns(part.path, &names(own), parts[0].path, &names(first))?;
        }
        let session = |part: &Part<'_>| part.rows.first().and_then(|row| row.session.clone());
        if is_session_per_file
            && let Some(same) = earlier.iter().find(|other| session(other) == session(part))
        {
            let found = format!("the same name as that of {}", same.path.display());
            let expected = "a name of its own for each session, with --session-per-file";
            return Err(InputError::new(part.path, found, expected));
        }
        check_time(&parts[k - 1], part)?;
    }
    Ok(parts.into_iter().flat_map(|part| part.rows).collect())
}

/// Checks that the columns of a file are those of the `first`.
fn check_columns(
    path: &Path,
    own: &[String],
    first: &Path,
    of_first: &[String],
) -> Result<(), InputError> {
    let beyond = |these: &[String], those: &[String]| -> Vec<String> {
        let is_beyond = |name: &&String| !those.contains(name);
        these.iter().filter(is_beyond).cloned().collect()
    };
    let (more, fewer) = (beyond(own, of_first), beyond(of_first, own));
    let listed = |names: &[String]| {
        let plural = if names.len() == 1 { "" } else { "s" };
        format!("column{plural} {}", names.join(", "))
    };
    let first = first.display();
    let (found, expected) = match (more.is_empty(), fewer.is_empty()) {
        (true, true) => return Ok(()),
        (false, _) => (
            format!("the {}", listed(&more)),
            format!("only columns that {first} has"),
        ),
        (true, false) => (
            format!("no {}", listed(&fewer)),
            format!("the columns of {first}"),
        ),
    };
    Err(InputError::new(path, found, expected))
}

/// Returns where the rows of each part stand in the measurement file; nothing for a single part.
pub fn note(parts: &[Part<'_>]) -> Option<String> {
    let mut next = FIRST_LINE;
    let of = |part: &Part<'_>| {
        let first = next;
        next += part.rows.len();
        format!("{first}–{} from {}", next - 1, part.path.display())
    };
    let all: Vec<String> = parts.iter().map(of).collect();
    (all.len() > 1).then(|| format!("lines of the measurement file: {}", all.join(", ")))
}

/// Checks that `part` begins when the file in front of it has ended.
fn check_time(before: &Part<'_>, part: &Part<'_>) -> Result<(), InputError> {
    let times = |part: &Part<'_>| -> Vec<(f64, usize)> {
        let timed = part.rows.iter();
        timed
            .filter_map(|row| Some((row.time_s?, row.line)))
            .collect()
    };
    let first = times(part).into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    let last = times(before).into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
    let (Some((first, line)), Some((last, _))) = (first, last) else {
        return Ok(());
    };
    if first >= last {
        return Ok(());
    }
    let found = format!(
        "a time {:.0} s before the end of {}",
        last - first,
        before.path.display()
    );
    let expected = "files in the order of time, with one clock for all of them";
    Err(InputError::new(part.path, found, expected)
        .at_line(line)
        .with_help(
            "if the clock starts at 0 in each file, take [time] out of the map: the rows then count in the order of the \
             files",
        ))
}
