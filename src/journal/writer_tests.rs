use super::super::tests::Directory;
use super::*;

#[test]
fn slow_emptying_of_the_log_blocks_no_later_motion() {
    let directory = Directory::new();
    let store = Store::open(directory.place()).unwrap();
    let mut writer = JournalWriter::new(store, None, Retention::default(), Vec::new()).unwrap();
    let fill = "CREATE TABLE filling (bytes BLOB); INSERT INTO filling VALUES (zeroblob(20 * 1024 * 1024))";
    writer.store.connection.execute_batch(fill).unwrap();
    assert!(writer.store.log_is_large());
    // The watch reports this while a checkpoint is slow.
    writer.shared.set_failure(Some("the disk is slow".to_owned()));
    writer.empty_log(Instant::now());
    assert!(!writer.store.log_is_large() && !writer.shared.failing());
}

#[test]
fn records_deleted_while_a_write_fails_leave_the_last_head() {
    let directory = Directory::new();
    let store = Store::open(directory.place()).unwrap();
    let id = super::super::identity::identify(&store.connection).id;
    let head = HeadFile::of(&store, id);
    let events = (0..3).map(|_| Event::new(row::now(), None, Detail::Gateway(GatewayEvent::Ended)));
    let mut writer = JournalWriter::new(store, head, Retention::default(), events.collect()).unwrap();
    writer.store.connection.execute_batch("DELETE FROM events WHERE seq > 1").unwrap();
    // As after a write that failed.
    writer.ends = None;
    writer.own(GatewayEvent::Ended);
    writer.commit(Instant::now());
    drop(writer);
    let findings = super::super::verify(&directory.journal()).unwrap().findings;
    let texts: Vec<_> = findings.iter().map(ToString::to_string).collect();
    assert!(texts.iter().any(|text| text.contains("its head names")), "{texts:?}");
}
