//! The smallest firmware: loads a model and prints the corrected joints of every query, in bits.
#![no_std]
#![no_main]

use poegp_runtime::Model400;
use semihosting::{print, println, process};

#[cortex_m_rt::entry]
fn main() -> ! {
    let mut model = Model400::new();
    model.load(include_bytes!("../arm.blob")).unwrap();
    for line in include_str!("../queries.txt").lines().skip(2) {
        let (mut query, mut count) = ([0.0; 9], 0);
        for word in line.split(' ').take_while(|word| *word != "|") {
            query[count] = f32::from_bits(u32::from_str_radix(word, 16).unwrap());
            count += 1;
        }
        let (payload_kg, joints) = query[..count].split_last().unwrap();
        let command = model.correct(joints, *payload_kg);
        print!("elastic");
        for joint in &command.joints[..joints.len()] {
            print!(" {:08x}", joint.to_bits());
        }
        let error = command.position_error.to_bits();
        println!(" | {error:08x} | {:02x}", command.status.bits());
    }
    process::exit(0)
}
