//! Fast and slow followers of events.

use super::*;

/// Returns the sequence numbers of the next events.
async fn seqs(follow: &mut EventStream, count: usize) -> Vec<i64> {
    let mut seqs = Vec::new();
    while seqs.len() < count {
        seqs.push(next_event(follow).await.seq);
    }
    seqs
}

#[tokio::test]
async fn follower_gets_each_event_once_during_writes() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    for number in 0..249 {
        record(&journal, link(number, "left"));
    }
    keep(&journal, link(249, "left")).await;
    let writing = {
        let journal = journal.clone();
        tokio::spawn(async move {
            for number in 0..250 {
                keep(&journal, link(number, "left")).await;
            }
        })
    };
    let followers: Vec<_> = (0..5_u16)
        .map(|after| {
            let journal = journal.clone();
            tokio::spawn(async move {
                seqs(&mut journal.follow(Some(i64::from(after) * 50), Filter::default()), 500 - usize::from(after) * 50)
                    .await
            })
        })
        .collect();
    writing.await.unwrap();
    for (after, follower) in (0..).zip(followers) {
        assert_eq!(follower.await.unwrap(), (after * 50 + 1..=500).collect::<Vec<_>>());
    }
}

#[tokio::test]
async fn slow_follower_reads_missed_events_from_the_file() {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    let filter = Filter { gripper: Some(name("left")), ..Filter::default() };
    let (mut all, mut left) = (journal.follow(None, Filter::default()), journal.follow(None, filter));
    for number in 0..1500 {
        record(&journal, link(number, if number % 2 == 0 { "left" } else { "right" }));
    }
    keep(&journal, link(0, "left")).await;
    assert_eq!(seqs(&mut all, 1501).await, (1..=1501).collect::<Vec<_>>());
    assert_eq!(seqs(&mut left, 751).await, (1..=1501).step_by(2).collect::<Vec<_>>());
    journal.close().await.unwrap();
    assert_eq!(seqs(&mut all, 1).await, [1502]);
    assert_eq!(all.next().await.unwrap(), None);
    assert_eq!(left.next().await.unwrap(), None);
}

#[tokio::test]
async fn cursor_beyond_the_newest_event_starts_at_the_beginning() {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    for number in 0..3 {
        keep(&journal, link(number, "left")).await;
    }
    assert_eq!(seqs(&mut journal.follow(Some(4711), Filter::default()), 3).await, [1, 2, 3]);
    let mut from_now = journal.follow(Some(3), Filter::default());
    keep(&journal, link(3, "left")).await;
    assert_eq!(seqs(&mut from_now, 1).await, [4]);
}
