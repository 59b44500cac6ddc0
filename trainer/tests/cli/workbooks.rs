//! Sheets of xlsx files as tables, and small files that expand to too much.

use std::io::Write;

use crate::foreign_files::{assert_simulated, folder, import};
use crate::program::Folder;
use crate::texts::texts;

const WORKBOOK: &str = r#"
file = { sheet = "Measured", skip_lines = 2 }
joints = { driver = "fanuc" }
payload = { column = "Load" }
position = { columns = ["X", "Y", "Z"] }
orientation = { kind = "rotation-vector", columns = ["RX", "RY", "RZ"] }
"#;

#[test]
fn a_sheet_of_a_workbook_is_a_table() {
    let _texts = texts();
    let files = folder(&["workbook.xlsx"]);
    import(&files, "workbook.xlsx", WORKBOOK).ok();
    assert_simulated(&files);
    // The decimal mark of the map applies to text; a number in a sheet has none.
    let comma = WORKBOOK.replace("skip_lines", "decimal = \",\", skip_lines");
    import(&files, "workbook.xlsx", &comma).ok();
    assert_simulated(&files);
    for (from, to) in [
        ("sheet = \"Measured\", ", ""),
        ("\"Measured\"", "\"Sheet1\""),
        ("\"Measured\"", "\"Notes\""),
        ("\"X\", \"Y\", \"Z\"]", "1, \"Y\", \"Z\"], unit = \"mm\""),
        ("skip_lines = 2", "skip_lines = 3"),
    ] {
        import(&files, "workbook.xlsx", &WORKBOOK.replace(from, to)).refused();
    }
    let bytes = std::fs::read(files.path("workbook.xlsx")).unwrap();
    files.write("workbook.xlsx", &bytes[..bytes.len() / 2]);
    import(&files, "workbook.xlsx", WORKBOOK).refused();
    files.write("workbook.xlsx", bytes);
    files.refuses("import workbook.xlsx --preset kuka --out data.csv");
}

/// Returns a zip file of these parts, with compressed bytes.
fn zip(parts: &[(&str, &[u8])]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, bytes) in parts {
        let options = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Deflated);
        archive.start_file(*name, options).unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

/// Returns a workbook with one sheet.
fn workbook(sheet: &str, shared: &str) -> Vec<u8> {
    let head = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>";
    let main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    let relations = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    let package = "http://schemas.openxmlformats.org/package/2006/relationships";
    let book = format!(
        "{head}<workbook xmlns=\"{main}\" xmlns:r=\"{relations}\"><sheets><sheet name=\"S\" sheetId=\"1\" r:id=\"r1\"/></sheets></workbook>"
    );
    let links = format!(
        "{head}<Relationships xmlns=\"{package}\"><Relationship Id=\"r1\" Type=\"{relations}/worksheet\" Target=\"worksheets/sheet1.xml\"/>\
         <Relationship Id=\"r2\" Type=\"{relations}/sharedStrings\" Target=\"sharedStrings.xml\"/></Relationships>"
    );
    let strings = format!("{head}<sst xmlns=\"{main}\"><si><t>{shared}</t></si></sst>");
    let sheet =
        format!("{head}<worksheet xmlns=\"{main}\"><sheetData>{sheet}</sheetData></worksheet>");
    let start = format!(
        "{head}<Relationships xmlns=\"{package}\"><Relationship Id=\"r1\" Type=\"{relations}/officeDocument\" Target=\"xl/workbook.xml\"/></Relationships>"
    );
    zip(&[
        ("_rels/.rels", start.as_bytes()),
        ("xl/workbook.xml", book.as_bytes()),
        ("xl/_rels/workbook.xml.rels", links.as_bytes()),
        ("xl/sharedStrings.xml", strings.as_bytes()),
        ("xl/worksheets/sheet1.xml", sheet.as_bytes()),
    ])
}

/// The numbers of a sheet have no decimal mark, so that none of them is in doubt; a text has one.
#[test]
fn only_the_texts_of_a_sheet_have_a_decimal_mark() {
    let folder = Folder::new();
    let names = [
        "A1", "A2", "A3", "A4", "A5", "A6", "X", "Y", "Z", "A", "B", "C",
    ];
    let field = |column: usize, row: usize, text: &str, is_number: bool| {
        let letter = char::from(b'A' + column as u8);
        match is_number {
            true => format!("<c r=\"{letter}{row}\"><v>{text}</v></c>"),
            false => {
                format!("<c r=\"{letter}{row}\" t=\"inlineStr\"><is><t>{text}</t></is></c>")
            }
        }
    };
    for (x, is_number, code) in [
        ("250.125", true, 0),
        ("250.125", false, 2),
        ("250.1", false, 0),
    ] {
        let head = names
            .iter()
            .enumerate()
            .map(|(i, name)| field(i, 1, name, false));
        let values = [
            "10", "20", "30", "40", "50", "60", x, "200", "300", "1", "2", "3",
        ];
        let values = values.iter().enumerate();
        let values = values.map(|(i, text)| field(i, 2, text, i != 6 || is_number));
        let sheet = format!(
            "<row r=\"1\">{}</row><row r=\"2\">{}</row>",
            head.collect::<String>(),
            values.collect::<String>()
        );
        folder.write("sheet.xlsx", workbook(&sheet, ""));
        let outcome = folder.run("import sheet.xlsx --preset kuka --out data.csv");
        assert_eq!(outcome.code, Some(code), "{x} {is_number}: {outcome:#?}");
        if code == 0 {
            let text = folder.text("data.csv");
            let wanted = format!("60,{x},200,300,");
            assert!(text.contains(&wanted), "{text}");
        }
    }
}

/// Small files that expand to too much: compressed zeros, one text for many cells, one cell far out in each of many rows.
#[test]
fn a_small_workbook_that_holds_too_much_is_refused() {
    let _texts = texts();
    let folder = Folder::new();
    let map = WORKBOOK.replace("sheet = \"Measured\", ", "");
    let row = |i: usize, cell: &str| {
        format!("<row r=\"{i}\">{}</row>", cell.replace('#', &i.to_string()))
    };
    let rows = |count: usize, cell: &str| -> String { (1..=count).map(|i| row(i, cell)).collect() };
    let text = "x".repeat(100_000);
    let files = [
        (
            "zeros.xlsx",
            zip(&[("xl/media/image1.png", &vec![0; 300 << 20])]),
        ),
        (
            "shared.xlsx",
            workbook(&rows(3_000, "<c r=\"A#\" t=\"s\"><v>0</v></c>"), &text),
        ),
        (
            "far.xlsx",
            workbook(&rows(10_100, "<c r=\"ALL#\"><v>1</v></c>"), ""),
        ),
    ];
    for (name, bytes) in files {
        assert!(bytes.len() < 1 << 20, "{name}: {} bytes", bytes.len());
        folder.write(name, bytes);
        import(&folder, name, &map).refused();
    }
}
