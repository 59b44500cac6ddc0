//! The driver keeps the controller's rules, and reports the controller's errors.

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};

use crate::drivers::flash::{
    BYTES, FlashFault, FlashRegister, FlashRegisters, SECTOR, SectorFlash,
};
use crate::flash_controller::{Controller, Shared, WRITE_PROTECTED};

/// `OPTCR` with brown-out level 3, no write protection, and read protection off.
pub const LEVEL_3: u32 = 0x0fff_aae1;
/// `OPTCR` as delivered: brown-out reset off.
pub const OFF: u32 = 0x0fff_aaed;

pub fn driver(controller: Controller) -> (SectorFlash<Shared>, Shared) {
    let shared = Shared::new(controller);
    (SectorFlash::new(shared.clone(), 100), shared)
}

fn read(flash: &mut SectorFlash<Shared>, at: u32, length: usize) -> Vec<u8> {
    let mut bytes = vec![0; length];
    flash.read(at, &mut bytes).unwrap();
    bytes
}

#[test]
fn what_is_written_is_read_and_what_is_erased_is_gone() {
    for (options, above_2_7_v) in [(LEVEL_3, true), (OFF, false), (OFF, true)] {
        let (mut flash, shared) = driver(Controller {
            above_2_7_v,
            ..Controller::new(options)
        });
        assert_eq!(flash.supply_is_sure(), options == LEVEL_3);
        let bytes: Vec<u8> = (0..=255).collect();
        for at in [0, SECTOR, BYTES - 256] {
            // Read first, so that the cache has the old content.
            assert_eq!(read(&mut flash, at, 256), [0xff; 256]);
            flash.write(at, &bytes).unwrap();
            assert_eq!(read(&mut flash, at, 256), bytes);
        }
        flash.erase(SECTOR, 2 * SECTOR).unwrap();
        assert_eq!(read(&mut flash, SECTOR, 256), [0xff; 256]);
        assert_eq!(read(&mut flash, 0, 256), bytes);
        assert_eq!(read(&mut flash, BYTES - 256, 256), bytes);
        let mut shared = shared;
        // The controller is locked again, and the caches are on again.
        assert_eq!(shared.get(FlashRegister::Control), 1 << 31);
        assert_eq!(shared.get(FlashRegister::Access), 0x705);
        let written = shared.0.borrow();
        assert!(
            written.cells[..2 * SECTOR as usize]
                .iter()
                .all(|b| *b == 0xff)
        );
    }
}

/// Programming turns ones into zeros and never the reverse. The controller does not report that, so the store reads back.
#[test]
fn programming_clears_bits_only() {
    let (mut flash, _) = driver(Controller::new(LEVEL_3));
    flash.write(4, &[0xf0; 4]).unwrap();
    flash.write(4, &[0x3c; 4]).unwrap();
    assert_eq!(read(&mut flash, 0, 12)[4..8], [0x30; 4]);
}

#[test]
fn what_the_controller_refuses_is_an_error_and_the_next_operation_works() {
    // Sector 7 is write-protected.
    let (mut flash, shared) = driver(Controller::new(LEVEL_3 & !(1 << 23)));
    let protected = Err(FlashFault::Refused(WRITE_PROTECTED));
    assert_eq!(flash.erase(SECTOR, 2 * SECTOR), protected);
    assert_eq!(flash.write(SECTOR, &[0; 8]), protected);
    assert_eq!(flash.erase(0, SECTOR), Ok(()));
    assert_eq!(flash.write(0, &[1; 8]), Ok(()));
    assert_eq!(read(&mut flash, SECTOR, 8), [0xff; 8]);
    assert_eq!(shared.0.borrow().operations, 3);
}

#[test]
fn a_controller_that_stays_busy_or_locked_is_an_error() {
    let (mut flash, shared) = driver(Controller {
        stays_busy: true,
        ..Controller::new(LEVEL_3)
    });
    assert_eq!(flash.erase(0, SECTOR), Err(FlashFault::Busy));
    assert_eq!(flash.write(0, &[0; 4]), Err(FlashFault::Busy));
    assert_eq!(shared.0.borrow().operations, 1);
    let (mut flash, shared) = driver(Controller::new(LEVEL_3));
    shared.0.borrow_mut().locked_up = true;
    assert_eq!(flash.erase(0, SECTOR), Err(FlashFault::Locked));
    assert_eq!(flash.write(0, &[0; 4]), Err(FlashFault::Locked));
    assert_eq!(shared.0.borrow().operations, 0);
}

#[test]
fn addresses_are_checked_before_anything_is_done() {
    let (mut flash, shared) = driver(Controller::new(LEVEL_3));
    let mut bytes = [0; 8];
    assert_eq!(
        flash.read(BYTES - 4, &mut bytes),
        Err(FlashFault::OutOfBounds)
    );
    assert_eq!(flash.read(2, &mut bytes), Err(FlashFault::NotAligned));
    assert_eq!(
        flash.write(u32::MAX - 3, &bytes),
        Err(FlashFault::OutOfBounds)
    );
    assert_eq!(flash.write(0, &bytes[..3]), Err(FlashFault::NotAligned));
    assert_eq!(flash.erase(0, BYTES + SECTOR), Err(FlashFault::OutOfBounds));
    assert_eq!(flash.erase(SECTOR, 0), Err(FlashFault::OutOfBounds));
    assert_eq!(flash.erase(0, SECTOR - 4), Err(FlashFault::NotAligned));
    assert_eq!(shared.0.borrow().operations, 0);
}
