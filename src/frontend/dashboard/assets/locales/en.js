// English. Each key is in every dictionary: a test holds that.

export const en = {
  width: 'Width', speed: 'Speed', force: 'Force', ago: '{span} ago', close: 'Close', newer: 'The gateway serves a newer version of this page.', reload: 'Load it', cancel: 'Cancel',
  'span.seconds': '{count} s', 'span.minutes': '{count} min', 'span.hours': '{count} h', 'span.days': '{count} d',

  'nav.label': 'Views', 'nav.skip': 'Skip to the controls', 'nav.operate': 'Operate', 'nav.history': 'History', 'nav.log': 'Log', 'nav.device': 'Device', 'nav.all': 'All',

  'bar.link': 'Link', 'bar.state': 'State', 'bar.control': 'Control', 'bar.grippers': 'Grippers', 'bar.mine': 'you', 'bar.free': 'nobody',
  'bar.unknown': 'unknown', 'bar.since': 'since {time}', 'bar.no_alarms': 'No alarms', 'bar.alarm': '1 alarm', 'bar.alarms': '{count} alarms',
  'bar.gateway.connecting': 'connecting…', 'bar.gateway.silent': 'gateway silent', 'bar.gateway.lost': 'gateway gone',

  'stop.word': 'STOP', 'stop.all': 'all grippers', 'stop.one': 'the gripper', 'stop.not': 'not an emergency stop',
  'stop.sent': 'FAST STOP sent…', 'stop.confirmed': 'FAST STOP: confirmed by the grippers.',
  'stop.unconfirmed': 'FAST STOP latched, not confirmed by every gripper yet: it is being repeated.',
  'stop.failed': 'FAST STOP did not get through: {why} Use the emergency stop of the cell.',

  'link.connecting': 'connecting', 'link.connected': 'connected', 'link.unresponsive': 'silent', 'link.reconnecting': 'reconnecting',
  'state.IDLE': 'Idle', 'state.GRASPING': 'Gripping', 'state.NO_PART': 'No part', 'state.PART_LOST': 'Part lost', 'state.HOLDING': 'Holding',
  'state.RELEASING': 'Releasing', 'state.POSITIONING': 'Positioning', 'state.ERROR': 'Error', 'state.FAST_STOP': 'FAST STOP', 'state.unknown': 'Unknown',

  'stale.connecting': 'Connecting to the gateway…', 'stale.silent': 'The gateway does not answer', 'stale.lost': 'No connection to the gateway',
  'stale.since': 'Since {time} ({span}). What lies below is old.',
  'stale.link.connecting': 'This gripper was not reached yet', 'stale.link.unresponsive': 'The gripper is silent', 'stale.link.reconnecting': 'No link to the gripper',

  'jaws.closing': 'closing', 'jaws.opening': 'opening', 'jaws.target': 'target {width} mm', 'jaws.label': 'Opening width {width} mm', 'jaws.not_referenced': 'Not referenced: home first',
  'figure.stroke': '0 – {max} mm', 'figure.soft': 'soft limits {min} – {max} mm', 'figure.max': 'at most {max} {unit}',

  'chart.title': 'Charts', 'chart.window': 'Window', 'chart.pause': 'Pause', 'chart.resume': 'Go on', 'chart.now': 'now',
  'chart.label': '{what} over the last {seconds} s', 'chart.begin': 'grip begins', 'chart.held': 'part held', 'chart.end': 'ended otherwise',

  'motion.title': 'Move', 'motion.fast_stop': 'FAST STOP {gripper}',
  'command.home': 'Home', 'command.move': 'Move', 'command.grip': 'Grip', 'command.release': 'Release', 'command.stop': 'Stop', 'command.custom': 'Custom command',
  'outcome.running': 'runs…', 'outcome.SUCCESS': 'done', 'outcome.PART_HELD': 'part held', 'outcome.NO_PART': 'no part found', 'outcome.BLOCKED': 'blocked', 'outcome.ABORTED': 'aborted',
  'outcome.RANGE': 'ran into a limit', 'outcome.TIMEOUT': 'took too long', 'outcome.FAILED': 'failed', 'outcome.REFUSED': 'refused', 'outcome.UNKNOWN': 'unknown: it may have happened',
  'last.none': 'No command yet.',
  'field.width': 'Width', 'field.force': 'Gripping force', 'field.part': 'Part', 'field.part_hint': 'optional, for the records', 'field.more': 'More', 'field.direction': 'Homing direction', 'field.block': 'When blocked on a move',
  'direction.default': 'as configured', 'direction.outer': 'outwards', 'direction.inner': 'inwards',
  'block.stop': 'stop, motor off', 'block.clamp': 'keep pushing (snaps when freed)',
  'why.link': 'Not possible: no link to the gripper.', 'why.fast_stop': 'Not possible: a FAST STOP holds.', 'why.control': 'Take control to move the fingers.', 'why.running': 'A command runs: Stop ends it.',
  'why.not_referenced': 'Home first: the fingers are not referenced.', 'why.limits': 'A value is beyond its limits.', 'why.ready': 'Ready: Grip, Release and Move go to {width} mm.',
  'limit.missing': 'a number is needed', 'limit.low': 'at least {min}, at most {max}', 'limit.high': 'at most {max}, at least {min}', 'limit.unknown': 'limits not known yet', 'limit.soft': 'soft limits', 'limit.overdrive': 'overdrive',
  'jog.title': 'Jog', 'jog.close': 'Close', 'jog.open': 'Open', 'jog.hint': 'Moves while held, at {speed} mm/s; steps are in mm.',
  'preset.title': 'Presets', 'preset.none': 'None yet. They are kept in this browser.', 'preset.name': 'Name', 'preset.save': 'Save values', 'preset.remove': 'Remove {name}',

  'latch.title': 'FAST STOP', 'latch.by': 'By', 'latch.device': 'the gripper itself', 'latch.cause': 'Why', 'latch.at': 'When', 'latch.device_says': 'The gripper', 'latch.confirmed': 'has confirmed it', 'latch.unconfirmed': 'has not confirmed it yet: it is being repeated',
  'latch.check': 'Check first', 'latch.acknowledge': 'Acknowledge FAST STOP {id}', 'latch.hint': 'Acknowledging moves nothing. A newer FAST STOP has another name, and stays.',
  'cause.requested': 'Somebody asked for it', 'cause.client_lost': 'Who was in control was lost while the fingers moved', 'cause.unannounced_disconnect': 'The connection to the gripper ended unannounced', 'cause.temperature_fault': 'Temperature fault', 'cause.power_fault': 'Power fault',
  'cause.current_fault': 'Motor overloaded', 'cause.finger_fault': 'Finger fault', 'cause.soft_limit': 'The fingers ran into a soft limit', 'cause.unknown': 'The gripper does not say',
  'check.hands': 'No hand and no tool is between the fingers.', 'check.area': 'The cause in the cell is gone.', 'check.reason': 'Whoever stopped it agrees.', 'check.client': 'What had control is there again, or is to be left out.', 'check.part': 'A part that was held is where it should be.', 'check.gateway': 'The cable and the gateway are all right.',
  'check.cool': 'The gripper has cooled down.', 'check.load': 'Load, cycle time and surrounding temperature are within what the gripper stands.', 'check.power': 'The supply voltage is right.', 'check.cable': 'Plugs and cables are firm.', 'check.blocked': 'Nothing blocks the fingers.', 'check.wait': 'The fault has cleared by itself: it takes some time.',
  'check.finger': 'The fingers are mounted and plugged in.', 'check.limits': 'The soft limits fit the task.', 'check.device': 'The gripper’s own web page and the log say why.',

  'alarm.title': 'Alarms', 'alarm.none': 'Nothing is wrong.', 'alarm.hint': 'Acknowledged for this browser; a FAST STOP for everybody, at the controls.', 'alarm.active': 'active', 'alarm.cleared': 'over', 'alarm.acknowledged': 'active, acknowledged',
  'alarm.acknowledge': 'Acknowledge', 'alarm.acknowledge_one': 'Acknowledge: {alarm}', 'alarm.show': 'Show',
  'alarm.fast_stop': 'FAST STOP', 'alarm.journal': 'The journal takes no records', 'alarm.part_lost': 'Part lost', 'alarm.gateway': 'No connection to the gateway', 'alarm.link.connecting': 'not reached yet', 'alarm.link.unresponsive': 'silent', 'alarm.link.reconnecting': 'no link',
  'alarm.flag.TEMP_WARNING': 'warm', 'alarm.flag.TEMP_FAULT': 'temperature fault', 'alarm.flag.POWER_FAULT': 'power fault', 'alarm.flag.CURR_FAULT': 'motor overloaded', 'alarm.flag.FINGER_FAULT': 'finger fault', 'alarm.flag.SCRIPT_FAILURE': 'script failed',

  'control.title': 'Control', 'control.nobody': 'Nobody has control.', 'control.take': 'Take control', 'control.more': 'Ask for it', 'control.held_by': '{holder} has control.', 'control.mine': 'You have control, as {name}.', 'control.release': 'Give control back',
  'control.reserved': 'Reserved for {name}, who was lost while a part was held.', 'control.ask': 'Ask for control', 'control.asking': 'Asked. It comes when {holder} hands it over.', 'control.asked': '{name} asks for control.', 'control.hand_over': 'Hand over to {name}',
  'control.force': 'Take by force', 'control.force_sure': 'Yes, take it by force', 'control.force_hint': 'By force stops a running motion.',
  'control.if_gone': 'If this browser goes without giving control back', 'control.on_moving': 'While the fingers move', 'control.on_holding': 'While a part is held',
  'loss.fast_stop': 'FAST STOP', 'loss.stop': 'stop', 'loss.finish': 'finish the motion', 'loss.keep': 'keep holding',
  'gone.moving.fast_stop': 'Moving fingers are stopped by a FAST STOP.', 'gone.moving.stop': 'Moving fingers stop.', 'gone.moving.finish': 'A motion is finished; jogging stops all the same.', 'gone.holding.keep': 'A held part stays held, and the gripper is reserved for you.', 'gone.holding.fast_stop': 'A held part gets a FAST STOP.',
  'gone.link': 'It counts as gone 3 s after the last sign of life.', 'control.others': 'Who else is here', 'control.connections': 'Open connections: {list}', 'door.http': 'HTTP', 'door.ws': 'WebSocket', 'door.wsg': 'WSG port', 'door.zenoh': 'Zenoh',

  'machine.label': 'Gripper states; now: {state}', 'flags.title': 'State and flags', 'flags.reserved': 'Bits 10, 11 and 21 to 31 are reserved, and shown when set.', 'flag.reserved': 'reserved', 'flag.set': 'on', 'flag.clear': 'off',
  'flag.REFERENCED': 'referenced', 'flag.MOVING': 'moving', 'flag.BLOCKED_MINUS': 'blocked, closing', 'flag.BLOCKED_PLUS': 'blocked, opening', 'flag.SOFT_LIMIT_MINUS': 'at lower soft limit', 'flag.SOFT_LIMIT_PLUS': 'at upper soft limit', 'flag.AXIS_STOPPED': 'stopped by a Stop', 'flag.TARGET_POS_REACHED': 'target reached',
  'flag.OVERDRIVE_MODE': 'overdrive on', 'flag.FORCECNTL_MODE': 'force control', 'flag.FAST_STOP': 'FAST STOP', 'flag.TEMP_WARNING': 'temperature high', 'flag.TEMP_FAULT': 'temperature fault', 'flag.POWER_FAULT': 'power fault', 'flag.CURR_FAULT': 'motor overloaded', 'flag.FINGER_FAULT': 'finger fault',
  'flag.CMD_FAILURE': 'last command failed', 'flag.SCRIPT_RUNNING': 'script runs', 'flag.SCRIPT_FAILURE': 'script failed',

  'history.events': 'Events', 'history.grips': 'Motions', 'history.what': 'Records', 'history.kind': 'Kind', 'history.all': 'all', 'history.part': 'Part', 'history.outcome': 'Outcome', 'history.export': 'Export CSV', 'history.more': 'Older', 'history.none': 'Nothing on record.',
  'history.at': 'When', 'history.who': 'Who', 'history.details': 'What happened', 'history.duration': 'Took', 'history.contact': 'Contact', 'history.peak': 'Peak force', 'history.curve': 'Curve', 'history.pick': 'Pick a motion to see its curve.', 'history.exported': '{count} records exported.', 'history.bounded': 'The newest {count} records were exported: narrow the filters for others.',
  'kind.command': 'command', 'kind.fast_stop': 'FAST STOP', 'kind.acknowledge': 'acknowledge', 'kind.lease': 'control', 'kind.link': 'link', 'kind.device': 'device', 'kind.settings': 'setting', 'kind.refused': 'refused', 'kind.gateway': 'gateway',
  'event.admitted': '{command} begins', 'event.latched': 'FAST STOP: {cause}', 'event.confirmed': 'FAST STOP confirmed by the gripper', 'event.acknowledged': 'FAST STOP acknowledged', 'event.not_acknowledged': 'FAST STOP not cleared: {cause}',
  'event.taken': '{holder} takes control', 'event.forced': '{holder} takes control by force', 'event.requested': '{holder} asks for control', 'event.handed_over': 'control handed over to {holder}', 'event.released': '{holder} gives control back', 'event.lost': '{holder} was lost',
  'event.restarted': 'the gripper has restarted', 'event.replaced': 'another gripper answers', 'event.fault': 'fault: {flags}', 'event.fault_cleared': 'fault over: {flags}', 'event.foreign_motion': 'the fingers move, and nobody here asked for it', 'event.part_lost': 'part lost', 'event.refused': '{command} refused: {cause}',
  'event.started': 'gateway started, version {version}', 'event.configuration': 'configuration', 'event.unclean_end': 'the last run did not end in order', 'event.ended': 'gateway ended', 'event.records_lost': '{count} records lost', 'event.pruned': 'old records removed',

  'log.title': 'Frames on the wire', 'log.pause': 'Pause', 'log.resume': 'Go on', 'log.clear': 'Clear', 'log.hex': 'Hex', 'log.updates': 'Automatic updates', 'log.none': 'No frame yet. Automatic updates are hidden unless they are asked for.', 'log.missed': '{count} frames are missing here', 'log.frame': 'Frame', 'log.pick': 'Pick a frame to see its bytes.',
  'log.select': 'Pick bytes of the frame to see what they mean.', 'log.byte': 'byte {index}: {hex}', 'log.part.preamble': 'preamble', 'log.part.id': 'id', 'log.part.size': 'size', 'log.part.payload': 'payload', 'log.part.checksum': 'checksum',
  'type.u8': 'unsigned, 8 bits', 'type.i8': 'signed, 8 bits', 'type.u16': 'unsigned, 16 bits', 'type.i16': 'signed, 16 bits', 'type.u32': 'unsigned, 32 bits', 'type.i32': 'signed, 32 bits', 'type.f32': 'float', 'type.text': 'text',
  'editor.title': 'Command editor', 'editor.id': 'Id', 'editor.id_hint': '0x31, 31h or 49', 'editor.id_wrong': 'an id is 0x00 to 0xff', 'editor.payload': 'Parameters', 'editor.hint': 'e.g. 0x01 150.0f "text" 7; little endian', 'editor.wrong': '{what} is no byte, float or text', 'editor.long': 'at most {max} bytes', 'editor.frame': 'Frame with its checksum', 'editor.send': 'Send', 'editor.answer': 'Answer',
  'editor.moves': 'Ids that the gateway does not know count as motions, and need control.',

  'device.title': 'Device', 'device.model': 'Model', 'device.firmware': 'Firmware', 'device.hardware': 'Hardware revision', 'device.serial': 'Serial number', 'device.tag': 'Device tag', 'device.url': 'Address', 'device.temperature': 'Temperature', 'device.capabilities': 'Also has', 'device.if_gateway': 'If the gateway dies', 'device.stops': 'a moving gripper stops by itself', 'device.moves_on': 'a moving gripper moves on to its target',
  'limits.title': 'Limits', 'limits.stroke': 'Stroke', 'limits.speed': 'Speed', 'limits.acceleration': 'Acceleration', 'limits.force': 'Gripping force', 'limits.overdrive': 'With overdrive', 'limits.soft': 'Soft limits', 'limits.no_soft': 'none',
  'settings.title': 'Settings', 'settings.hint': 'Kept by the gripper until it restarts; the gateway sets them again then, but not overdrive.', 'settings.acceleration': 'Acceleration', 'settings.force_limit': 'Force limit', 'settings.minus': 'Smallest width', 'settings.plus': 'Largest width', 'settings.overdrive': 'Overdrive', 'settings.tag': 'Device tag', 'settings.set': 'Set', 'settings.clear': 'Clear', 'settings.on': 'Switch on', 'settings.off': 'Switch off', 'settings.tare': 'Tare the force sensor', 'settings.tag_hint': '64 printable ASCII characters at most', 'settings.done': 'Set.',
  'statistics.title': 'Statistics', 'statistics.total': 'Grips', 'statistics.no_part': 'without a part', 'statistics.lost_part': 'part lost', 'statistics.good': 'Good grips', 'statistics.reset': 'Reset', 'statistics.sure': 'Yes, reset',

  'all.title': 'All grippers', 'all.fleet': 'Fleet', 'all.no_fleet': 'This gateway is alone: there is no fleet.', 'all.gateway': 'Gateway', 'all.gripper': 'Gripper', 'all.age': 'Age', 'all.control': '{holder} has control', 'all.no_control': 'nobody in control',

  'foot.safety': 'STOP is a FAST STOP by software: it passes through this browser, the network and the gateway, and is not a safety function in the sense of ISO 13850. For an emergency use the emergency stop of the cell.', 'foot.name': 'This browser is', 'foot.language': 'Language', 'foot.theme': 'Looks', 'foot.docs': 'API', 'theme.auto': 'Auto', 'theme.light': 'Light', 'theme.dark': 'Dark',

  'problem.no_connection': 'The gateway did not answer.', 'problem.malformed': 'The gateway does not understand {field}.', 'problem.fast_stop': 'A FAST STOP holds: acknowledge it first.', 'problem.not_referenced': 'The fingers are not referenced: home first.', 'problem.already_running': 'A command runs already.', 'problem.lease_held': '{holder} has control.', 'problem.stale_lease': 'Control is somebody else’s by now.', 'problem.stale_fast_stop': 'There is a newer FAST STOP: look at it first.', 'problem.fast_stop_unconfirmed': 'The gripper has not confirmed the FAST STOP yet.',
  'problem.out_of_range': '{field} is {value}, and must be from {min} to {max}.', 'problem.device_refused': 'The gripper refuses.', 'problem.overloaded': 'Too much at once: try again.', 'problem.internal': 'The gateway made a mistake.', 'problem.device_protocol': 'The gripper’s answer makes no sense.', 'problem.link_down': 'There is no link to the gripper.', 'problem.journal_down': 'The journal takes no records.', 'problem.device_timeout': 'The gripper did not answer in time.', 'problem.not_found': 'There is no such thing.',
};
