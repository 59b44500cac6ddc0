//! `cargo run --release -p poegp-tests --example firmware FILE [BOARD]`: builds the firmware image of a board, by default
//! mps2-an386, and copies it to FILE.

use std::error::Error;

use poegp_tests::firmware_build::{Board, firmware_of};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (file, board) = match arguments.as_slice() {
        [file] => (file, Some(Board::default())),
        [file, name] => (file, Board::ALL.into_iter().find(|b| b.name() == name)),
        _ => return Err("usage: firmware FILE [BOARD]".into()),
    };
    let board = board.ok_or("found another board, expected mps2-an386, mps2-an500 or stm32f405")?;
    std::fs::copy(&firmware_of(board)?.elf, file)?;
    println!("{file}: firmware for {}", board.name());
    Ok(())
}
