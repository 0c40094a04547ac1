-- A journal of format 1: homing, a move, a grip, and a FAST STOP that is still latched.
PRAGMA auto_vacuum=INCREMENTAL;
PRAGMA application_id=1465075530;
PRAGMA user_version=1;
PRAGMA foreign_keys=OFF;
BEGIN TRANSACTION;
CREATE TABLE events(
    seq INTEGER PRIMARY KEY, at INTEGER NOT NULL, body TEXT NOT NULL, curve BLOB, hash BLOB NOT NULL,
    gripper TEXT AS (body ->> '$.gripper'),
    kind TEXT AS (body ->> '$.kind'),
    part_id TEXT AS (body ->> '$.part_id'),
    outcome TEXT AS (body ->> '$.outcome'),
    command_id TEXT AS (body ->> '$.command_id')
) STRICT;
INSERT INTO events VALUES(1,1795383617561,'{"seq":1,"at":"2026-11-22T21:40:17.561Z","gripper":null,"subject":null,"door":null,"command_id":null,"kind":"gateway","event":"started","version":"0.1.0","gateway":"gateway"}',NULL,X'299c79d07187dd1204d3d83d83a18c01d159b4716c7a41fb28bca9638bf0de59');
INSERT INTO events VALUES(2,1795383617561,'{"seq":2,"at":"2026-11-22T21:40:17.561Z","gripper":null,"subject":null,"door":null,"command_id":null,"kind":"gateway","event":"configuration","listen":"127.0.0.1:18999","grippers":["left=sim://wsg50?part_mm=20"]}',NULL,X'0db5a44bddd795a57c0dfaf4361b6dc12a8aea24ec38473a387ceff6ea921be0');
INSERT INTO events VALUES(3,1795383617565,'{"seq":3,"at":"2026-11-22T21:40:17.565Z","gripper":"left","subject":null,"door":null,"command_id":null,"kind":"link","link":"connected","link_cause":null}',NULL,X'9ed32277518ea568433c6257d50fbe893767c70774b6a1242a2f9f9e4db10478');
INSERT INTO events VALUES(4,1795383619040,'{"seq":4,"at":"2026-11-22T21:40:19.040Z","gripper":"left","subject":"http:127.0.0.1","door":"http","command_id":"01a20533-ede0-7404-8ad0-05d8ca09f2d1","kind":"command","phase":"admitted","command":"home","direction":"default"}',NULL,X'219bebf662d995a8f6996a284c9849ec01624e1bfc1e0bb2838f5652928f8039');
INSERT INTO events VALUES(5,1795383620205,'{"seq":5,"at":"2026-11-22T21:40:20.205Z","gripper":"left","subject":"http:127.0.0.1","door":"http","command_id":"01a20533-ede0-7404-8ad0-05d8ca09f2d1","kind":"command","phase":"done","command":"home","outcome":"SUCCESS","status":"E_SUCCESS","status_code":0,"reached_goal":true,"stalled":false,"width_mm":109.0,"force_n":0.0,"started_at":"2026-11-22T21:40:19.040Z","duration_ms":1165}',NULL,X'04edca8263f11c556211d9dabde7a1418376e5cbbdb92321f53bae5aa7c09ee0');
INSERT INTO events VALUES(6,1795383620220,'{"seq":6,"at":"2026-11-22T21:40:20.220Z","gripper":"left","subject":"http:127.0.0.1","door":"http","command_id":"01a20533-f27c-713b-8ba1-02bc60e5cf66","kind":"command","phase":"admitted","command":"move","width_mm":24.0,"speed_mm_s":300.0,"relative":false,"on_block":"stop"}',NULL,X'fc1a3d053eedb5c63446114c09ba52a1be3a6568b771b6f5b1252696c95a722d');
INSERT INTO events VALUES(7,1795383620657,'{"seq":7,"at":"2026-11-22T21:40:20.657Z","gripper":"left","subject":"http:127.0.0.1","door":"http","command_id":"01a20533-f27c-713b-8ba1-02bc60e5cf66","kind":"command","phase":"done","command":"move","outcome":"SUCCESS","status":"E_SUCCESS","status_code":0,"reached_goal":true,"stalled":false,"width_mm":24.0,"force_n":0.0,"started_at":"2026-11-22T21:40:20.220Z","duration_ms":436,"requested_width_mm":24.0,"requested_speed_mm_s":300.0}',NULL,X'10d52189f18a9387b66d138911aaaab18d2a5a3890bfb8124afbea249624d097');
INSERT INTO events VALUES(8,1795383620675,'{"seq":8,"at":"2026-11-22T21:40:20.675Z","gripper":"left","subject":"http:127.0.0.1","door":"http","command_id":"01a20533-f443-73fe-a81b-a0a19a54a670","kind":"command","phase":"admitted","command":"grip","width_mm":20.0,"speed_mm_s":300.0,"part_id":"P-1"}',NULL,X'734017263ca7893c4c950ddf5897063d52e27972ef622facf3eb913c8bb70a58');
INSERT INTO events VALUES(9,1795383620816,'{"seq":9,"at":"2026-11-22T21:40:20.816Z","gripper":"left","subject":"http:127.0.0.1","door":"http","command_id":"01a20533-f443-73fe-a81b-a0a19a54a670","kind":"command","phase":"done","command":"grip","outcome":"PART_HELD","status":"E_SUCCESS","status_code":0,"reached_goal":true,"stalled":true,"width_mm":19.8,"force_n":40.0,"started_at":"2026-11-22T21:40:20.675Z","duration_ms":140,"part_id":"P-1","requested_width_mm":20.0,"requested_speed_mm_s":300.0}',NULL,X'92844b1b7b2401a0adda3bba52cc1c7f1d2d39d81f7b755a1c0c62405b9f1570');
INSERT INTO events VALUES(10,1795383620829,'{"seq":10,"at":"2026-11-22T21:40:20.829Z","gripper":"left","subject":"http:127.0.0.1","door":"http","command_id":null,"kind":"fast_stop","event":"latched","fast_stop_id":"01a20533-f4dd-75cb-8f0e-c2c5c969f7b4","cause":"requested","reason":"","count":1}',NULL,X'2556451ef4906b494295d50d892f5324d239d70e3d116527a141113074ed954d');
INSERT INTO events VALUES(11,1795383620836,'{"seq":11,"at":"2026-11-22T21:40:20.836Z","gripper":"left","subject":null,"door":null,"command_id":null,"kind":"fast_stop","event":"confirmed","fast_stop_id":"01a20533-f4dd-75cb-8f0e-c2c5c969f7b4","cause":"requested","reason":"","count":1}',NULL,X'b67abff931aee9d66b31cdbc74fe951afaa1e9a4877effa2eeec987d2a59b41d');
INSERT INTO events VALUES(12,1795383621141,'{"seq":12,"at":"2026-11-22T21:40:21.141Z","gripper":"left","subject":null,"door":null,"command_id":null,"kind":"link","link":"reconnecting","link_cause":"disconnected cleanly"}',NULL,X'5c39e44a06e34888902256373718220ea076754a4f497896eadc53532939afac');
INSERT INTO events VALUES(13,1795383621144,'{"seq":13,"at":"2026-11-22T21:40:21.144Z","gripper":null,"subject":null,"door":null,"command_id":null,"kind":"gateway","event":"ended"}',NULL,X'1b571b24db2bdea248b3f09069cafa22e794aea2b618c1de295027451cbb2073');
CREATE TABLE grips(
    seq INTEGER PRIMARY KEY, at INTEGER NOT NULL, body TEXT NOT NULL, curve BLOB, hash BLOB NOT NULL,
    gripper TEXT AS (body ->> '$.gripper'),
    kind TEXT AS (body ->> '$.kind'),
    part_id TEXT AS (body ->> '$.part_id'),
    outcome TEXT AS (body ->> '$.outcome'),
    command_id TEXT AS (body ->> '$.id')
) STRICT;
INSERT INTO grips VALUES(1,1795383619040,'{"seq":1,"id":"01a20533-ede0-7404-8ad0-05d8ca09f2d1","gateway":"gateway","gripper":"left","serial_number":1001,"kind":"home","part_id":null,"outcome":"SUCCESS","subject":"http:127.0.0.1","started_at":"2026-11-22T21:40:19.040Z","duration_ms":1165,"width_mm":109.0,"force_n":0.0,"peak_force_n":40.0,"contact_width_mm":null,"time_to_contact_ms":null,"samples":117}',X'750000dc0b0012008827001400ac1b0016000000120000001600000012000000160000001200000016000000120000001400000014000000160000001200000016000000120000001600000014000000120000001600000014000000120000001600000014000000120000001600000014000000140000001400000012000000160000001400000014000000140000001200000016000000120000001600000014000000120000001600000012000000160000001400000012000000160000001200000016000000140000001200000016000000120000001600000014000000120000001600000014000000140000001400000014000000120000001600000012000000160000001400000012000000160000001200000016000000140000001200000016000000120000001600000012000000160000001200000016000000120000001600000012000000160000001200000016000000120000001600000012000000160000001400000014000000120000001600000014000000120000001600000012000000160000001200000016000000120000001600000012000000160000001200000016000000140000001400000012000000140000001600000014008f4ec03e1200db0bbf3e18008727001000a911001600ec28001290a70da21b00',X'fad9f6e9fb7f472b7d3ce315ca325e7e9ae59f692b445fc28e6ca8acb9d33122');
INSERT INTO grips VALUES(2,1795383620220,'{"seq":2,"id":"01a20533-f27c-713b-8ba1-02bc60e5cf66","gateway":"gateway","gripper":"left","serial_number":1001,"kind":"move","part_id":null,"outcome":"SUCCESS","subject":"http:127.0.0.1","requested_width_mm":24.0,"requested_speed_mm_s":300.0,"started_at":"2026-11-22T21:40:20.220Z","duration_ms":436,"width_mm":24.0,"force_n":0.0,"peak_force_n":0.0,"contact_width_mm":null,"time_to_contact_ms":null,"samples":44}',X'2c0090a70d00001400000014000000141ddb0b0014a903872700129b07872700148f0b87270018850f87270012f71287270012ed1687270014e11a87270016d31e87270012c72287270014bd2687270014b12a87270016852eab1b0014ef2e000014ef2e000012ef2e000014ef2e000016ef2e000014ef2e000012ef2e000014ef2e000014ef2e000016ef2e000014ef2e000014ef2e000014ef2e000012ef2e000014ef2e000014ef2e000014852dfa2300168f29a02700149725a4270012a121a4270014ab1daa270014b119ae270016bb15b6270012c111c0270014c70dd0270014c909f0270016c705c0280016b501b02500',X'15c924215ca972856aa82797a05407066571e4dda34b602e86f14d0fb54470af');
INSERT INTO grips VALUES(3,1795383620675,'{"seq":3,"id":"01a20533-f443-73fe-a81b-a0a19a54a670","gateway":"gateway","gripper":"left","serial_number":1001,"kind":"grip","part_id":"P-1","outcome":"PART_HELD","subject":"http:127.0.0.1","requested_width_mm":20.0,"requested_speed_mm_s":300.0,"started_at":"2026-11-22T21:40:20.675Z","duration_ms":140,"width_mm":19.8,"force_n":40.0,"peak_force_n":40.0,"contact_width_mm":19.95,"time_to_contact_ms":80,"samples":46}',X'2e0080f7020000140000001205f3030014c30287270014b70687270014ad0a87270016a10e87270012931287270016bd0bccb701d00f12c70100a01f1463d00fd00f1400000014000000140000001400000014900300bf3e140000001400000014000000140000001400000016000000120000001400000014000000140000001400000016000000120000001400000014000000160000001200000014000000140000001400000014000000160000001200000014000000140000001400000016000000140000001200000014000000',X'9ec3c8af209ccd18a6b8229ae4d63304b0452936e02989313274edbb664980da');
CREATE TABLE memory(
    gripper TEXT NOT NULL, key TEXT NOT NULL, value TEXT NOT NULL, hash BLOB NOT NULL, PRIMARY KEY(gripper, key)
) STRICT, WITHOUT ROWID;
INSERT INTO memory VALUES('','journal_id','01a20533-e813-7150-b08c-f5b471b2e93e',X'719e77f41fe6f80be1d7ac1787fd638e53c89f4ac5da5851e086ea365ec81122');
INSERT INTO memory VALUES('left','holding','"01a20533-f443-73fe-a81b-a0a19a54a670"',X'fec7dba34ddfe569ea30b6f8e7ef314f7726b920da7b5a9651c0db88317eadfe');
INSERT INTO memory VALUES('left','last_command','{"number":3,"id":"01a20533-f443-73fe-a81b-a0a19a54a670","outcome":"PART_HELD"}',X'f4a1e63ddfb2db4064e788da22a2e94a146c94e3be123f487903df3039ecc88b');
INSERT INTO memory VALUES('left','latch','{"epoch":1,"id":"01a20533-f4dd-75cb-8f0e-c2c5c969f7b4","by":"http:127.0.0.1","cause":"requested","reason":"","at":"2026-11-22T21:40:20.829Z","confirmed":false}',X'ff015f654a1c33a066333aa19e2bbee7a8bb68264dc30e164948e06d78cf25b6');
INSERT INTO memory VALUES('left','settings','{"serial_number":1001,"acceleration_mm_s2":null,"force_n":null,"soft_limits_cleared":false,"minus_mm":null,"plus_mm":null}',X'ac3bdb46889e0579de5a204b43b0b74cc3dbc12b9b13e5e95d09aa06a4891e74');
CREATE TABLE spans(
    chain TEXT NOT NULL, span INTEGER NOT NULL, oldest INTEGER NOT NULL, newest INTEGER NOT NULL,
    PRIMARY KEY(chain, span)
) STRICT, WITHOUT ROWID;
INSERT INTO spans VALUES('events',0,1795383617561,1795383621144);
INSERT INTO spans VALUES('grips',0,1795383619040,1795383620675);
CREATE TABLE running(command_id TEXT NOT NULL PRIMARY KEY, seq INTEGER NOT NULL) STRICT, WITHOUT ROWID;
CREATE TABLE anchors(chain TEXT NOT NULL PRIMARY KEY, seq INTEGER NOT NULL, hash BLOB NOT NULL) STRICT, WITHOUT ROWID;
CREATE INDEX events_gripper ON events(gripper);
CREATE INDEX events_kind ON events(kind);
CREATE INDEX events_gripper_kind ON events(gripper, kind);
CREATE INDEX events_outcome ON events(outcome) WHERE outcome IS NOT NULL;
CREATE INDEX events_gripper_outcome ON events(gripper, outcome) WHERE outcome IS NOT NULL;
CREATE INDEX events_part_id ON events(part_id) WHERE part_id IS NOT NULL;
CREATE INDEX events_gripper_part_id ON events(gripper, part_id) WHERE part_id IS NOT NULL;
CREATE INDEX events_part_id_outcome ON events(part_id, outcome) WHERE part_id IS NOT NULL;
CREATE INDEX events_gripper_part_id_outcome ON events(gripper, part_id, outcome) WHERE part_id IS NOT NULL;
CREATE INDEX events_command_id ON events(command_id) WHERE command_id IS NOT NULL;
CREATE INDEX grips_gripper ON grips(gripper);
CREATE INDEX grips_kind ON grips(kind);
CREATE INDEX grips_gripper_kind ON grips(gripper, kind);
CREATE INDEX grips_outcome ON grips(outcome);
CREATE INDEX grips_gripper_outcome ON grips(gripper, outcome);
CREATE INDEX grips_kind_outcome ON grips(kind, outcome);
CREATE INDEX grips_gripper_kind_outcome ON grips(gripper, kind, outcome);
CREATE INDEX grips_part_id ON grips(part_id) WHERE part_id IS NOT NULL;
CREATE INDEX grips_gripper_part_id ON grips(gripper, part_id) WHERE part_id IS NOT NULL;
CREATE INDEX grips_part_id_outcome ON grips(part_id, outcome) WHERE part_id IS NOT NULL;
CREATE INDEX grips_gripper_part_id_outcome ON grips(gripper, part_id, outcome) WHERE part_id IS NOT NULL;
CREATE INDEX grips_command_id ON grips(command_id);
COMMIT;
