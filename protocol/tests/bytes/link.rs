//! Every message as bytes, and the tables of the crate and of `docs/reference/link.md`, whose numbers never change.

use poegp_protocol::link::frame::{self, MAX_FRAME};
use poegp_protocol::link::{
    Cyclic, CyclicResponse, MAX_SIGNED, Message, REQUESTS, RESPONSES, Request, Response,
};
use serde::Serialize;

use crate::listing;
use crate::messages::{
    STARTS, decode_errors, longest_requests, longest_responses, query, refusals, requests,
    responses,
};

const LINK: &str = include_str!("../../../docs/reference/link.md");

fn bytes_of(value: &impl Serialize) -> Vec<u8> {
    let mut buffer = [0; 2_048];
    postcard::to_slice(value, &mut buffer).unwrap().to_vec()
}

/// Returns the number on the wire and variant name of each value.
fn numbered<'a, V: Serialize + core::fmt::Debug + 'a>(
    values: impl IntoIterator<Item = &'a V>,
) -> Vec<(u8, String)> {
    let name = |value: &V| {
        let text = format!("{value:?}");
        let end = text.find([' ', '(']).unwrap_or(text.len());
        text[..end].to_owned()
    };
    values
        .into_iter()
        .map(|value| (bytes_of(value)[0], name(value)))
        .collect()
}

/// Returns the names of a message's fields in the `Debug` output, for the outermost braces only.
fn field_names(value: &impl core::fmt::Debug) -> Vec<String> {
    let (mut names, mut word, mut depth) = (Vec::new(), String::new(), 0);
    for letter in format!("{value:?}").chars() {
        match letter {
            '{' | '[' => depth += 1,
            '}' | ']' => depth -= 1,
            ':' if depth == 1 => names.push(word.clone()),
            _ if letter.is_alphanumeric() || letter == '_' => {
                word.push(letter);
                continue;
            }
            _ => {}
        }
        word.clear();
    }
    names
}

/// Returns the field names in a row of a table: each is the text before a colon.
fn declared_names(row: &Message) -> Vec<String> {
    let fields = row.fields.split(", ").filter(|field| !field.is_empty());
    let name = |field: &str| field.split(':').next().unwrap_or("").to_owned();
    fields.map(name).collect()
}

fn assert_rows<V: Serialize + core::fmt::Debug>(rows: &[Message], values: &[V], longest: &[V]) {
    let names: Vec<_> = (0..)
        .zip(rows)
        .map(|(n, row)| (n, row.name.to_owned()))
        .collect();
    assert_eq!(numbered(values), names);
    assert_eq!(numbered(longest), names);
    for ((row, value), longest) in rows.iter().zip(values).zip(longest) {
        assert_eq!(bytes_of(longest).len(), row.max_bytes, "{}", row.name);
        if row.name != "Refused" {
            assert_eq!(declared_names(row), field_names(value), "{}", row.name);
        }
    }
}

#[test]
fn the_tables_are_those_of_the_types() {
    assert_rows(&REQUESTS, &requests(), &longest_requests());
    assert_rows(&RESPONSES, &responses(), &longest_responses());
    for (row, request) in REQUESTS.iter().zip(requests()) {
        assert_eq!(row.cyclic, request.is_cyclic(), "{}", row.name);
        let answers = RESPONSES.iter().filter(|answer| answer.name == row.answer);
        let expected = usize::from(row.name != "Signed");
        assert_eq!(answers.count(), expected, "{} is answered", row.name);
    }
    for answer in RESPONSES {
        assert!(answer.answer.is_empty() && !answer.cyclic);
        let asked = REQUESTS
            .iter()
            .filter(|row| row.answer == answer.name)
            .count();
        assert!(asked > 0 || answer.name == "Refused", "{}", answer.name);
    }
}

/// The messages that the cycle reads and writes itself are those of the tables.
#[test]
fn the_cyclic_messages_are_among_them() {
    for (number, row) in (0..).zip(REQUESTS) {
        let cyclic = Cyclic::of(number).map(|cyclic| format!("{cyclic:?}"));
        assert_eq!(cyclic, row.cyclic.then(|| row.name.to_owned()));
    }
    assert_eq!(Cyclic::of(REQUESTS.len() as u8), None);
    fn by_itself<R: CyclicResponse>(response: &R) -> Vec<u8> {
        bytes_of(&(R::NUMBER, response))
    }
    for response in responses() {
        let by_itself = match &response {
            Response::Evaluation(evaluation) => by_itself(evaluation),
            Response::Corrected(corrected) => by_itself(corrected),
            Response::Trace(trace) => by_itself(trace),
            Response::Refused(refusal) => by_itself(refusal),
            Response::Commanded(commanded) => by_itself(commanded),
            _ => continue,
        };
        assert_eq!(by_itself, bytes_of(&response), "{response:?}");
    }
}

/// A request within a signed request is read as it was written.
#[test]
fn requests_in_signed_ones() {
    for request in longest_requests() {
        let mut buffer = [0; MAX_SIGNED];
        match request.encode(&mut buffer) {
            Some(bytes) => assert_eq!(Request::decode(bytes), Some(request.clone())),
            None => assert!(!request.needs_signature(), "{request:?}"),
        }
    }
    let signed = Request::Signed {
        signature: &[],
        request: &[],
    };
    let mut buffer = [0; MAX_SIGNED];
    let bytes = signed.encode(&mut buffer).unwrap();
    assert_eq!(Request::decode(bytes), None);
    assert_eq!(Request::decode(&[14, 0]), None);
}

/// Returns the rows of the section of `docs/reference/link.md` with this heading, without quotes.
fn documented(heading: &str) -> Vec<(u8, Vec<String>)> {
    let (_, section) = LINK
        .split_once(&format!("\n## {heading}\n"))
        .unwrap_or_else(|| panic!("no section {heading}"));
    let section = section.split("\n## ").next().unwrap_or("");
    let plain = |cells: Vec<String>| cells.iter().map(|cell| cell.replace('`', "")).collect();
    listing::numbered_rows(section)
        .into_iter()
        .map(|(number, cells)| (number, plain(cells)))
        .collect()
}

#[test]
fn the_tables_are_those_of_the_documentation() {
    let number = |number: usize| (number as u8, number.to_string());
    let expected = REQUESTS.iter().enumerate().map(|(n, row)| {
        let (n, text) = number(n);
        let by = if row.cyclic { "cycle" } else { "service" };
        let bytes = row.max_bytes.to_string();
        let cells = [&text, row.name, row.fields, &bytes, row.answer, by];
        (n, cells.map(str::to_owned).to_vec())
    });
    assert_eq!(documented("Requests"), expected.collect::<Vec<_>>());
    let expected = RESPONSES.iter().enumerate().map(|(n, row)| {
        let (n, text) = number(n);
        let bytes = row.max_bytes.to_string();
        let cells = [&text, row.name, row.fields, &bytes];
        (n, cells.map(str::to_owned).to_vec())
    });
    assert_eq!(documented("Responses"), expected.collect::<Vec<_>>());
}

#[test]
fn the_refusals_and_starts_are_those_of_the_documentation() {
    let named = |heading: &str| -> Vec<_> {
        let rows = documented(heading).into_iter();
        rows.map(|(number, cells)| (number, cells[1].clone()))
            .collect()
    };
    assert_eq!(named("Refusals"), numbered(&refusals()));
    assert_eq!(named("Decode errors"), numbered(&decode_errors()));
    let fields = |row: &[String]| -> Vec<String> {
        let text = row[2].split(", ").filter(|field| field.contains(": "));
        text.map(|field| field.split(':').next().unwrap_or("").to_owned())
            .collect()
    };
    for ((_, row), refusal) in documented("Refusals").iter().zip(refusals()) {
        assert_eq!(fields(row), field_names(&refusal), "{refusal:?}");
    }
    for ((_, row), error) in documented("Decode errors").iter().zip(decode_errors()) {
        assert_eq!(fields(row), field_names(&error), "{error:?}");
    }
    assert_eq!(named("Why the device started"), numbered(&STARTS));
    for ((_, row), start) in documented("Why the device started").iter().zip(STARTS) {
        assert_eq!(fields(row), field_names(&start), "{start:?}");
    }
}

#[test]
fn the_lengths_are_those_of_the_documentation() {
    let on_line = |length: usize| {
        let raw = length + frame::OVERHEAD;
        poegp_protocol::link::cobs::max_encoded(raw) + 1
    };
    let longest = |rows: &[Message]| rows.iter().map(|row| row.max_bytes).max().unwrap();
    let service_answer = RESPONSES
        .iter()
        .filter(|answer| {
            REQUESTS
                .iter()
                .all(|row| row.answer != answer.name || !row.cyclic)
        })
        .map(|row| row.max_bytes)
        .max()
        .unwrap();
    for (what, bytes) in [
        ("longest frame", MAX_FRAME),
        ("longest answer", on_line(longest(&RESPONSES))),
        ("longest answer of a service", on_line(service_answer)),
        ("longest `Correct`", on_line(38)),
        ("longest `Corrected`", on_line(57)),
        ("longest `Command`", on_line(38)),
        ("longest `Commanded`", on_line(61)),
    ] {
        let row = format!("| {what} | {bytes} |");
        assert!(
            LINK.contains(&row),
            "{row} is not in docs/reference/link.md"
        );
    }
    let wait = format!("on the line, at most {} bytes;", on_line(service_answer));
    assert!(LINK.contains(&wait), "{wait}");
    assert_eq!(on_line(longest(&REQUESTS)), MAX_FRAME);
    // The service relies on this: no answer is longer than the longest request.
    assert!(on_line(longest(&RESPONSES)) < MAX_FRAME);
}

#[test]
fn the_longest_messages_fit_a_frame() {
    fn framed(message: &impl Serialize) -> usize {
        let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
        frame::encode(u16::MAX, message, &mut scratch, &mut out)
            .expect("fits a frame")
            .len()
    }
    let requests = longest_requests();
    let longest = requests.iter().map(framed).max();
    assert!(longest <= Some(MAX_FRAME));
    for response in longest_responses() {
        assert!(Some(framed(&response)) < longest, "{response:?}");
    }
}

#[test]
fn the_worked_example_is_what_the_encoder_writes() {
    let [raw, wire] = listing::hex_blocks(LINK).try_into().expect("two listings");
    let (mut scratch, mut out) = ([0; 64], [0; 64]);
    let request = Request::Correct(query());
    let encoded = frame::encode(7, &request, &mut scratch, &mut out).unwrap();
    assert_eq!(encoded, wire, "{encoded:02x?}");
    assert_eq!(scratch[..raw.len()], raw, "{:02x?}", &scratch[..raw.len()]);
    let mut received = wire[..wire.len() - 1].to_vec();
    assert_eq!(frame::decode(&mut received), Ok((7, request)));
}

/// 0.5, 2 and 0.25.
const CYCLE: [u8; 15] = [
    0, 0, 0, 0x3f, 0, 0, 0, 0x40, 0, 0, 0x80, 0x3e, 0xa4, 0xe8, 0x03,
];

#[test]
fn requests_as_bytes() {
    let query = |number| vec![number, 2, 0, 0, 0, 0x3f, 0, 0, 0x80, 0x3e, 0, 0, 0, 0x40];
    let table = [
        vec![0],
        query(1),
        query(2),
        query(3),
        vec![4],
        vec![5, 0xac, 0x02, 0xff, 0xff, 0xff, 0xff, 0x0f, 1],
        vec![6, 0x80, 0x01, 3, 0, 1, 0xff],
        vec![7],
        vec![8],
        vec![9, 0xac, 0x02],
        vec![10, 0x80, 0x01],
        vec![11, 1],
        [12].into_iter().chain(0..32).collect(),
        vec![13],
        vec![14],
        query(15),
        [&[16, 0xe8, 0x07][..], &CYCLE].concat(),
        vec![17],
        [&[18, 64][..], &[1; 64], &[1, 14]].concat(),
    ];
    assert_eq!(table.len(), requests().len());
    for (request, bytes) in requests().iter().zip(&table) {
        assert_eq!(bytes_of(request), *bytes, "{request:?}");
        assert_eq!(postcard::from_bytes(bytes), Ok(request.clone()));
    }
}

#[test]
fn refusals_as_bytes() {
    let table: [&[u8]; 29] = [
        &[10, 0],
        &[10, 1, 1, 2],
        &[10, 2],
        &[10, 3],
        &[10, 4, 0xac, 0x02, 0xc8, 0x01],
        &[10, 5],
        &[10, 6, 5, 4],
        &[10, 7, 9, 8],
        &[10, 8, 7, 8],
        &[10, 9, 1, 2],
        &[10, 10, 1],
        &[10, 11, 11],
        &[10, 12, 3],
        &[10, 13],
        &[10, 14, 0xac, 0x02],
        &[10, 15],
        &[10, 16, 16],
        &[10, 17],
        &[10, 18],
        &[10, 19],
        &[10, 20, 0xf0, 0xa2, 0x04, 0xa4, 0xe8, 0x03],
        &[10, 21, 0xac, 0x02, 0xf0, 0xa2, 0x04],
        &[10, 22],
        &[10, 23],
        &[10, 24],
        &[10, 25, 4],
        &[10, 26, 100],
        &[10, 27],
        &[10, 28, 0x80, 0xc8, 0xd0, 0x07, 0x80, 0xf4, 0x8d, 0x50],
    ];
    assert_eq!(table.len(), refusals().len());
    for (refusal, bytes) in refusals().into_iter().zip(table) {
        let response = Response::Refused(refusal);
        assert_eq!(bytes_of(&response), bytes, "{response:?}");
        assert_eq!(postcard::from_bytes(bytes), Ok(response));
    }
    let table: [&[u8]; 7] = [
        &[0, 20, 3],
        &[1],
        &[2, 0x82, 0x02, 1],
        &[3],
        &[4, 20, 21],
        &[5, 1, 2],
        &[6],
    ];
    for (error, bytes) in decode_errors().into_iter().zip(table) {
        assert_eq!(bytes_of(&error), bytes, "{error:?}");
    }
    let table: [&[u8]; 7] = [
        &[0],
        &[1],
        &[2],
        &[3],
        &[4, 0xc6, 0x01],
        &[5, 0x80, 0x01],
        &[6],
    ];
    for (start, bytes) in STARTS.into_iter().zip(table) {
        assert_eq!(bytes_of(&start), bytes, "{start:?}");
    }
}

#[test]
fn responses_as_bytes() {
    let model = [
        &[3][..],
        b"ARM\x017",
        &[
            5, 2, 0xac, 0x02, 0xb2, 0xde, 0x03, 1, 0xac, 0x02, 2, 0, 0x40, 0,
        ],
    ]
    .concat();
    let stored = [1, 1, 0xac, 0x02, 6];
    let mut identity = vec![0, 3, 5];
    identity.extend(b"0.1.0\x80\x01\x04mps2");
    identity.extend([0xe8, 0x07, 0x80, 0x80, 0x01, 0xc0, 0xf0, 0xf5, 0x0b]);
    identity.extend([0xa8, 0xc3, 0x01, 1, 1, 2, 3, 4, 5, 6, 7, 8, 1, 0xe8, 0x07]);
    identity.extend(CYCLE);
    identity.push(1);
    identity.extend(&model);
    identity.extend([1, 0, 1]);
    identity.extend(stored);
    identity.extend([0xc8, 1, 4, 0xc6, 0x01]);
    let mut evaluation = vec![0x84, 0x86, 0x88, 0x08];
    evaluation.extend((0..12).flat_map(|index| (index as f32).to_le_bytes()));
    evaluation.extend([0, 0, 0, 0x3f].repeat(6));
    evaluation.extend([0, 0, 0x80, 0x3e, 1, 0, 0, 0, 0x40, 4, 0xc8, 0x01]);
    let mut corrected = vec![2, 0x80, 0x01, 2, 0, 0, 0, 0x3f, 0, 0, 0x80, 0x3e];
    corrected.extend([0, 0, 0, 0x3f, 0, 0, 0, 0x40, 0, 0, 0x80, 0x3e]);
    let mut commanded = corrected.clone();
    commanded[0] = 11;
    commanded.extend([0, 0, 0x80, 0x3f, 32, 0xc8, 0x01]);
    corrected.extend([32, 0xc8, 0x01]);
    let mut trace = vec![3, 2, 0, 0, 0, 0x3f, 0, 0, 0x80, 0x3f];
    trace.extend([0, 0, 0x80, 0x3e].repeat(6));
    trace.extend([0, 0, 0x80, 0x3f].repeat(12));
    trace.extend(&evaluation);
    let table = [
        identity,
        [vec![1], evaluation].concat(),
        corrected,
        trace,
        vec![4],
        vec![5, 0x80, 0x01],
        [vec![6], model].concat(),
        [&[7][..], &stored].concat(),
        [8].into_iter()
            .chain(1..=13)
            .chain([127, 0x80, 1])
            .chain(14..=18)
            .collect(),
        vec![9],
        vec![10, 5],
        commanded,
        [12].into_iter().chain(0..16).collect(),
    ];
    assert_eq!(table.len(), responses().len());
    for (response, bytes) in responses().into_iter().zip(table) {
        assert_eq!(bytes_of(&response), bytes, "{response:?}");
        assert_eq!(postcard::from_bytes(&bytes), Ok(response));
    }
}
