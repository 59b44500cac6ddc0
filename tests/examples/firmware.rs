//! `cargo run --release -p poegp-tests --example firmware FILE [BOARD [SOURCES TARGET]]`: builds the firmware image of a board,
//! by default mps2-an386, and copies it to FILE. SOURCES is another copy of this repository, TARGET the folder to compile in.

use std::error::Error;
use std::path::Path;

use poegp_tests::firmware_build::{Board, firmware_from, firmware_of};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (file, board, elsewhere) = match arguments.as_slice() {
        [file] => (file, Board::default(), None),
        [file, name] => (file, board(name)?, None),
        [file, name, source, target] => (file, board(name)?, Some((source, target))),
        _ => return Err("usage: firmware FILE [BOARD [SOURCES TARGET]]".into()),
    };
    let elf = match elsewhere {
        None => firmware_of(board)?.elf.clone(),
        Some((source, target)) => firmware_from(Path::new(source), Path::new(target), board)?.elf,
    };
    std::fs::copy(elf, file)?;
    println!("{file}: firmware for {}", board.name());
    Ok(())
}

fn board(name: &str) -> Result<Board, String> {
    let mut boards = Board::ALL.into_iter();
    let found = boards.find(|board| board.name() == name);
    found.ok_or_else(|| {
        let names = Board::ALL.map(Board::name).join(", ");
        format!("found the board {name:?}, expected one of {names}")
    })
}
