//! What outlives a gateway or leaves it: the journal, grip records, backups, alarms and webhooks.

mod alarms;
mod backups;
mod grip_records;
mod journal_files;
mod kills;
mod webhooks;
