//! The touch file of a simulation; columns in which no row has a reading are omitted.

/// Columns of the readings.
const READINGS: [&str; 7] = ["corner", "value_mm", "gx", "gy", "gz", "u_px", "v_px"];

/// A row of the touch file.
pub(super) struct Row {
    pub feature: String,
    /// Fields of [`READINGS`], separated by commas.
    pub reading: String,
    /// Payload and joints, each after a comma.
    pub state: String,
}

/// Writes the file; the joint columns `joints` come last.
pub(super) fn csv(comment: &str, joints: &str, rows: &[Row]) -> String {
    let is_used = |k: &usize| {
        let mut fields = rows.iter().map(|row| row.reading.split(',').nth(*k));
        fields.any(|field| field.is_some_and(|field| !field.is_empty()))
    };
    let used: Vec<usize> = (0..READINGS.len()).filter(is_used).collect();
    let mut out = format!("# {comment}\nfeature");
    for k in &used {
        out += &format!(",{}", READINGS[*k]);
    }
    out += &format!(",payload_kg,{joints}\n");
    for row in rows {
        let fields: Vec<&str> = row.reading.split(',').collect();
        out += &row.feature;
        for k in &used {
            out += &format!(",{}", fields[*k]);
        }
        out += &row.state;
        out.push('\n');
    }
    out
}
