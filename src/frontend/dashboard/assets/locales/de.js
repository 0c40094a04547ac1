// German. Each key is in every dictionary: a test holds that.

export const de = {
  width: 'Öffnungsweite', speed: 'Geschwindigkeit', force: 'Kraft', ago: 'vor {span}', close: 'Schließen', newer: 'Das Gateway liefert eine neuere Fassung dieser Seite.', reload: 'Laden', cancel: 'Abbrechen',
  'span.seconds': '{count} s', 'span.minutes': '{count} min', 'span.hours': '{count} h', 'span.days': '{count} d',

  'nav.label': 'Ansichten', 'nav.skip': 'Zu den Bedienelementen', 'nav.operate': 'Bedienen', 'nav.history': 'Verlauf', 'nav.log': 'Protokoll', 'nav.device': 'Gerät', 'nav.all': 'Alle',

  'bar.link': 'Verbindung', 'bar.state': 'Zustand', 'bar.control': 'Steuert', 'bar.grippers': 'Greifer', 'bar.mine': 'Sie', 'bar.free': 'niemand',
  'bar.unknown': 'unbekannt', 'bar.since': 'seit {time}', 'bar.no_alarms': 'Keine Alarme', 'bar.alarm': '1 Alarm', 'bar.alarms': '{count} Alarme',
  'bar.gateway.connecting': 'verbindet…', 'bar.gateway.silent': 'Gateway stumm', 'bar.gateway.lost': 'Gateway fort',

  'stop.word': 'STOPP', 'stop.all': 'alle Greifer', 'stop.one': 'den Greifer', 'stop.not': 'kein Not-Halt',
  'stop.sent': 'FAST STOP gesendet…', 'stop.confirmed': 'FAST STOP: von den Greifern bestätigt.',
  'stop.unconfirmed': 'FAST STOP gesetzt, noch nicht von jedem Greifer bestätigt: er wird wiederholt.',
  'stop.failed': 'FAST STOP kam nicht durch: {why} Benutzen Sie den Not-Halt der Zelle.',

  'link.connecting': 'verbindet', 'link.connected': 'verbunden', 'link.unresponsive': 'stumm', 'link.reconnecting': 'verbindet neu',
  'state.IDLE': 'Ruht', 'state.GRASPING': 'Greift', 'state.NO_PART': 'Kein Teil', 'state.PART_LOST': 'Teil verloren', 'state.HOLDING': 'Hält',
  'state.RELEASING': 'Lässt los', 'state.POSITIONING': 'Fährt', 'state.ERROR': 'Fehler', 'state.FAST_STOP': 'FAST STOP', 'state.unknown': 'Unbekannt',

  'stale.connecting': 'Verbindung zum Gateway wird aufgebaut…', 'stale.silent': 'Das Gateway antwortet nicht', 'stale.lost': 'Keine Verbindung zum Gateway',
  'stale.since': 'Seit {time} ({span}). Was darunter liegt, ist alt.',
  'stale.link.connecting': 'Dieser Greifer wurde noch nicht erreicht', 'stale.link.unresponsive': 'Der Greifer ist stumm', 'stale.link.reconnecting': 'Keine Verbindung zum Greifer',

  'jaws.closing': 'schließt', 'jaws.opening': 'öffnet', 'jaws.target': 'Ziel {width} mm', 'jaws.label': 'Öffnungsweite {width} mm', 'jaws.not_referenced': 'Nicht referenziert: erst Referenzfahrt',
  'figure.stroke': '0 – {max} mm', 'figure.soft': 'Soft-Limits {min} – {max} mm', 'figure.max': 'höchstens {max} {unit}',

  'chart.title': 'Kurven', 'chart.window': 'Zeitfenster', 'chart.pause': 'Anhalten', 'chart.resume': 'Weiter', 'chart.now': 'jetzt',
  'chart.label': '{what} der letzten {seconds} s', 'chart.begin': 'Griff beginnt', 'chart.held': 'Teil gehalten', 'chart.end': 'anders beendet',

  'motion.title': 'Bewegen', 'motion.fast_stop': 'FAST STOP {gripper}',
  'command.home': 'Referenz', 'command.move': 'Fahren', 'command.grip': 'Greifen', 'command.release': 'Loslassen', 'command.stop': 'Halt', 'command.custom': 'Eigener Befehl',
  'outcome.running': 'läuft…', 'outcome.SUCCESS': 'erledigt', 'outcome.PART_HELD': 'Teil gehalten', 'outcome.NO_PART': 'kein Teil gefunden', 'outcome.BLOCKED': 'blockiert', 'outcome.ABORTED': 'abgebrochen',
  'outcome.RANGE': 'an eine Grenze gestoßen', 'outcome.TIMEOUT': 'dauerte zu lange', 'outcome.FAILED': 'fehlgeschlagen', 'outcome.REFUSED': 'abgelehnt', 'outcome.UNKNOWN': 'unbekannt: vielleicht ausgeführt',
  'last.none': 'Noch kein Befehl.',
  'field.width': 'Weite', 'field.force': 'Greifkraft', 'field.part': 'Teil', 'field.part_hint': 'freiwillig, für die Aufzeichnung', 'field.more': 'Mehr', 'field.direction': 'Richtung der Referenzfahrt', 'field.block': 'Wenn beim Fahren blockiert',
  'direction.default': 'wie eingestellt', 'direction.outer': 'nach außen', 'direction.inner': 'nach innen',
  'block.stop': 'anhalten, Motor aus', 'block.clamp': 'weiter drücken (schnellt, wenn frei)',
  'why.link': 'Nicht möglich: keine Verbindung zum Greifer.', 'why.fast_stop': 'Nicht möglich: ein FAST STOP liegt an.', 'why.control': 'Zum Bewegen die Steuerung übernehmen.', 'why.running': 'Ein Befehl läuft: Halt beendet ihn.',
  'why.not_referenced': 'Erst Referenzfahrt: die Finger sind nicht referenziert.', 'why.limits': 'Ein Wert ist außerhalb seiner Grenzen.', 'why.ready': 'Bereit: Greifen, Loslassen und Fahren gehen auf {width} mm.',
  'limit.missing': 'eine Zahl wird gebraucht', 'limit.low': 'mindestens {min}, höchstens {max}', 'limit.high': 'höchstens {max}, mindestens {min}', 'limit.unknown': 'Grenzen noch unbekannt', 'limit.soft': 'Soft-Limits', 'limit.overdrive': 'Overdrive',
  'jog.title': 'Tippbetrieb', 'jog.close': 'Zu', 'jog.open': 'Auf', 'jog.hint': 'Fährt, solange gedrückt, mit {speed} mm/s; Schritte in mm.',
  'preset.title': 'Vorgaben', 'preset.none': 'Noch keine. Sie bleiben in diesem Browser.', 'preset.name': 'Name', 'preset.save': 'Werte sichern', 'preset.remove': '{name} entfernen',

  'latch.title': 'FAST STOP', 'latch.by': 'Von', 'latch.device': 'vom Greifer selbst', 'latch.cause': 'Warum', 'latch.at': 'Wann', 'latch.device_says': 'Der Greifer', 'latch.confirmed': 'hat ihn bestätigt', 'latch.unconfirmed': 'hat ihn noch nicht bestätigt: er wird wiederholt',
  'latch.check': 'Erst prüfen', 'latch.acknowledge': 'FAST STOP {id} quittieren', 'latch.hint': 'Quittieren bewegt nichts. Ein neuerer FAST STOP hat einen anderen Namen und bleibt.',
  'cause.requested': 'Jemand hat ihn verlangt', 'cause.client_lost': 'Wer steuerte, ging verloren, während die Finger fuhren', 'cause.unannounced_disconnect': 'Die Verbindung zum Greifer endete unangekündigt', 'cause.temperature_fault': 'Temperaturfehler', 'cause.power_fault': 'Fehler der Stromversorgung',
  'cause.current_fault': 'Motor überlastet', 'cause.finger_fault': 'Fingerfehler', 'cause.soft_limit': 'Die Finger liefen in ein Soft-Limit', 'cause.unknown': 'Der Greifer sagt es nicht',
  'check.hands': 'Keine Hand und kein Werkzeug ist zwischen den Fingern.', 'check.area': 'Die Ursache in der Zelle ist behoben.', 'check.reason': 'Wer ihn ausgelöst hat, ist einverstanden.', 'check.client': 'Was steuerte, ist wieder da oder soll es nicht mehr.', 'check.part': 'Ein gehaltenes Teil ist, wo es sein soll.', 'check.gateway': 'Kabel und Gateway sind in Ordnung.',
  'check.cool': 'Der Greifer ist abgekühlt.', 'check.load': 'Last, Takt und Umgebungstemperatur sind, was der Greifer verträgt.', 'check.power': 'Die Versorgungsspannung stimmt.', 'check.cable': 'Stecker und Kabel sitzen fest.', 'check.blocked': 'Nichts blockiert die Finger.', 'check.wait': 'Der Fehler ist von selbst vergangen: das dauert etwas.',
  'check.finger': 'Die Finger sind montiert und angesteckt.', 'check.limits': 'Die Soft-Limits passen zur Aufgabe.', 'check.device': 'Die Webseite des Greifers und das Protokoll sagen, warum.',

  'alarm.title': 'Alarme', 'alarm.none': 'Alles in Ordnung.', 'alarm.hint': 'Quittiert für diesen Browser; ein FAST STOP für alle, bei den Bedienelementen.', 'alarm.active': 'aktiv', 'alarm.cleared': 'vorbei', 'alarm.acknowledged': 'aktiv, quittiert',
  'alarm.acknowledge': 'Quittieren', 'alarm.acknowledge_one': 'Quittieren: {alarm}', 'alarm.show': 'Zeigen',
  'alarm.fast_stop': 'FAST STOP', 'alarm.journal': 'Das Journal nimmt nichts an', 'alarm.part_lost': 'Teil verloren', 'alarm.gateway': 'Keine Verbindung zum Gateway', 'alarm.link.connecting': 'noch nicht erreicht', 'alarm.link.unresponsive': 'stumm', 'alarm.link.reconnecting': 'keine Verbindung',
  'alarm.flag.TEMP_WARNING': 'warm', 'alarm.flag.TEMP_FAULT': 'Temperaturfehler', 'alarm.flag.POWER_FAULT': 'Fehler der Stromversorgung', 'alarm.flag.CURR_FAULT': 'Motor überlastet', 'alarm.flag.FINGER_FAULT': 'Fingerfehler', 'alarm.flag.SCRIPT_FAILURE': 'Skript fehlgeschlagen',

  'control.title': 'Steuerung', 'control.nobody': 'Niemand steuert.', 'control.take': 'Steuerung übernehmen', 'control.more': 'Darum bitten', 'control.held_by': '{holder} steuert.', 'control.mine': 'Sie steuern, als {name}.', 'control.release': 'Steuerung abgeben',
  'control.reserved': 'Vorbehalten für {name}: verloren, während ein Teil gehalten wurde.', 'control.ask': 'Um Steuerung bitten', 'control.asking': 'Gebeten. Sie kommt, wenn {holder} sie übergibt.', 'control.asked': '{name} bittet um die Steuerung.', 'control.hand_over': 'An {name} übergeben',
  'control.force': 'Erzwingen', 'control.force_sure': 'Ja, erzwingen', 'control.force_hint': 'Erzwingen hält eine laufende Bewegung an.',
  'control.if_gone': 'Wenn dieser Browser verschwindet, ohne die Steuerung abzugeben', 'control.on_moving': 'Während die Finger fahren', 'control.on_holding': 'Während ein Teil gehalten wird',
  'loss.fast_stop': 'FAST STOP', 'loss.stop': 'anhalten', 'loss.finish': 'Bewegung beenden', 'loss.keep': 'weiter halten',
  'gone.moving.fast_stop': 'Fahrende Finger stoppt ein FAST STOP.', 'gone.moving.stop': 'Fahrende Finger halten an.', 'gone.moving.finish': 'Eine Bewegung läuft zu Ende; der Tippbetrieb hält trotzdem an.', 'gone.holding.keep': 'Ein gehaltenes Teil bleibt gehalten, und der Greifer ist Ihnen vorbehalten.', 'gone.holding.fast_stop': 'Bei gehaltenem Teil kommt ein FAST STOP.',
  'gone.link': 'Verschwunden ist er 3 s nach dem letzten Lebenszeichen.', 'control.others': 'Wer sonst da ist', 'control.connections': 'Offene Verbindungen: {list}', 'door.http': 'HTTP', 'door.ws': 'WebSocket', 'door.wsg': 'WSG-Port', 'door.zenoh': 'Zenoh',

  'machine.label': 'Greiferzustände; jetzt: {state}', 'flags.title': 'Zustand und Flags', 'flags.reserved': 'Die Bits 10, 11 und 21 bis 31 sind reserviert; sie erscheinen, wenn sie gesetzt sind.', 'flag.reserved': 'reserviert', 'flag.set': 'an', 'flag.clear': 'aus',
  'flag.REFERENCED': 'referenziert', 'flag.MOVING': 'fährt', 'flag.BLOCKED_MINUS': 'blockiert beim Schließen', 'flag.BLOCKED_PLUS': 'blockiert beim Öffnen', 'flag.SOFT_LIMIT_MINUS': 'am unteren Soft-Limit', 'flag.SOFT_LIMIT_PLUS': 'am oberen Soft-Limit', 'flag.AXIS_STOPPED': 'durch Halt gestoppt', 'flag.TARGET_POS_REACHED': 'Ziel erreicht',
  'flag.OVERDRIVE_MODE': 'Overdrive an', 'flag.FORCECNTL_MODE': 'Kraftregelung', 'flag.FAST_STOP': 'FAST STOP', 'flag.TEMP_WARNING': 'Temperatur hoch', 'flag.TEMP_FAULT': 'Temperaturfehler', 'flag.POWER_FAULT': 'Versorgungsfehler', 'flag.CURR_FAULT': 'Motor überlastet', 'flag.FINGER_FAULT': 'Fingerfehler',
  'flag.CMD_FAILURE': 'letzter Befehl misslang', 'flag.SCRIPT_RUNNING': 'Skript läuft', 'flag.SCRIPT_FAILURE': 'Skript misslang',

  'history.events': 'Ereignisse', 'history.grips': 'Bewegungen', 'history.what': 'Aufzeichnungen', 'history.kind': 'Art', 'history.all': 'alle', 'history.part': 'Teil', 'history.outcome': 'Ausgang', 'history.export': 'CSV-Export', 'history.more': 'Ältere', 'history.none': 'Nichts aufgezeichnet.',
  'history.at': 'Wann', 'history.who': 'Wer', 'history.details': 'Was geschah', 'history.duration': 'Dauer', 'history.contact': 'Kontakt', 'history.peak': 'Spitzenkraft', 'history.curve': 'Kurve', 'history.pick': 'Wählen Sie eine Bewegung, um ihre Kurve zu sehen.', 'history.exported': '{count} Einträge exportiert.', 'history.bounded': 'Die neuesten {count} Einträge sind exportiert: für andere die Filter enger stellen.',
  'kind.command': 'Befehl', 'kind.fast_stop': 'FAST STOP', 'kind.acknowledge': 'Quittierung', 'kind.lease': 'Steuerung', 'kind.link': 'Verbindung', 'kind.device': 'Gerät', 'kind.settings': 'Einstellung', 'kind.refused': 'abgelehnt', 'kind.gateway': 'Gateway',
  'event.admitted': '{command} beginnt', 'event.latched': 'FAST STOP: {cause}', 'event.confirmed': 'FAST STOP vom Greifer bestätigt', 'event.acknowledged': 'FAST STOP quittiert', 'event.not_acknowledged': 'FAST STOP bleibt: {cause}',
  'event.taken': '{holder} übernimmt die Steuerung', 'event.forced': '{holder} erzwingt die Steuerung', 'event.requested': '{holder} bittet um die Steuerung', 'event.handed_over': 'Steuerung an {holder} übergeben', 'event.released': '{holder} gibt die Steuerung ab', 'event.lost': '{holder} ging verloren',
  'event.restarted': 'der Greifer wurde neu gestartet', 'event.replaced': 'ein anderer Greifer antwortet', 'event.fault': 'Fehler: {flags}', 'event.fault_cleared': 'Fehler vorbei: {flags}', 'event.foreign_motion': 'die Finger fahren, und niemand hier hat es verlangt', 'event.part_lost': 'Teil verloren', 'event.refused': '{command} abgelehnt: {cause}',
  'event.started': 'Gateway gestartet, Version {version}', 'event.configuration': 'Konfiguration', 'event.unclean_end': 'der letzte Lauf endete nicht ordentlich', 'event.ended': 'Gateway beendet', 'event.records_lost': '{count} Einträge verloren', 'event.pruned': 'alte Einträge entfernt',

  'log.title': 'Telegramme auf der Leitung', 'log.pause': 'Anhalten', 'log.resume': 'Weiter', 'log.clear': 'Leeren', 'log.hex': 'Hex', 'log.updates': 'Automatische Meldungen', 'log.none': 'Noch kein Telegramm. Automatische Meldungen sind verborgen, bis man sie verlangt.', 'log.missed': '{count} Telegramme fehlen hier', 'log.frame': 'Telegramm', 'log.pick': 'Wählen Sie ein Telegramm, um seine Bytes zu sehen.',
  'log.select': 'Wählen Sie Bytes des Telegramms, um ihre Bedeutung zu sehen.', 'log.byte': 'Byte {index}: {hex}', 'log.part.preamble': 'Präambel', 'log.part.id': 'Kennung', 'log.part.size': 'Größe', 'log.part.payload': 'Nutzdaten', 'log.part.checksum': 'Prüfsumme',
  'type.u8': 'ohne Vorzeichen, 8 Bit', 'type.i8': 'mit Vorzeichen, 8 Bit', 'type.u16': 'ohne Vorzeichen, 16 Bit', 'type.i16': 'mit Vorzeichen, 16 Bit', 'type.u32': 'ohne Vorzeichen, 32 Bit', 'type.i32': 'mit Vorzeichen, 32 Bit', 'type.f32': 'Gleitkomma', 'type.text': 'Text',
  'editor.title': 'Befehlseditor', 'editor.id': 'Kennung', 'editor.id_hint': '0x31, 31h oder 49', 'editor.id_wrong': 'eine Kennung ist 0x00 bis 0xff', 'editor.payload': 'Parameter', 'editor.hint': 'z. B. 0x01 150.0f "text" 7; little endian', 'editor.wrong': '{what} ist kein Byte, Gleitkommawert oder Text', 'editor.long': 'höchstens {max} Bytes', 'editor.frame': 'Telegramm mit Prüfsumme', 'editor.send': 'Senden', 'editor.answer': 'Antwort',
  'editor.moves': 'Kennungen, die das Gateway nicht kennt, gelten als Bewegung und brauchen die Steuerung.',

  'device.title': 'Gerät', 'device.model': 'Modell', 'device.firmware': 'Firmware', 'device.hardware': 'Hardware-Stand', 'device.serial': 'Seriennummer', 'device.tag': 'Gerätekennung', 'device.url': 'Adresse', 'device.temperature': 'Temperatur', 'device.capabilities': 'Hat außerdem', 'device.if_gateway': 'Wenn das Gateway stirbt', 'device.stops': 'ein fahrender Greifer hält von selbst', 'device.moves_on': 'ein fahrender Greifer fährt bis zum Ziel',
  'limits.title': 'Grenzen', 'limits.stroke': 'Hub', 'limits.speed': 'Geschwindigkeit', 'limits.acceleration': 'Beschleunigung', 'limits.force': 'Greifkraft', 'limits.overdrive': 'Mit Overdrive', 'limits.soft': 'Soft-Limits', 'limits.no_soft': 'keine',
  'settings.title': 'Einstellungen', 'settings.hint': 'Der Greifer behält sie bis zum Neustart; dann setzt sie das Gateway wieder, Overdrive aber nicht.', 'settings.acceleration': 'Beschleunigung', 'settings.force_limit': 'Kraftgrenze', 'settings.minus': 'Kleinste Weite', 'settings.plus': 'Größte Weite', 'settings.overdrive': 'Overdrive', 'settings.tag': 'Gerätekennung', 'settings.set': 'Setzen', 'settings.clear': 'Löschen', 'settings.on': 'Einschalten', 'settings.off': 'Ausschalten', 'settings.tare': 'Kraftsensor tarieren', 'settings.tag_hint': 'höchstens 64 druckbare ASCII-Zeichen', 'settings.done': 'Gesetzt.',
  'statistics.title': 'Statistik', 'statistics.total': 'Griffe', 'statistics.no_part': 'ohne Teil', 'statistics.lost_part': 'Teil verloren', 'statistics.good': 'Gute Griffe', 'statistics.reset': 'Zurücksetzen', 'statistics.sure': 'Ja, zurücksetzen',

  'all.title': 'Alle Greifer', 'all.fleet': 'Flotte', 'all.no_fleet': 'Dieses Gateway ist allein: es gibt keine Flotte.', 'all.gateway': 'Gateway', 'all.gripper': 'Greifer', 'all.age': 'Alter', 'all.control': '{holder} steuert', 'all.no_control': 'niemand steuert',

  'foot.safety': 'STOPP ist ein FAST STOP durch Software: er geht durch diesen Browser, das Netz und das Gateway und ist keine Sicherheitsfunktion im Sinne der ISO 13850. Im Notfall den Not-Halt der Zelle benutzen.', 'foot.name': 'Dieser Browser heißt', 'foot.language': 'Sprache', 'foot.theme': 'Aussehen', 'foot.docs': 'API', 'theme.auto': 'Auto', 'theme.light': 'Hell', 'theme.dark': 'Dunkel',

  'problem.no_connection': 'Das Gateway hat nicht geantwortet.', 'problem.malformed': 'Das Gateway versteht {field} nicht.', 'problem.fast_stop': 'Ein FAST STOP liegt an: erst quittieren.', 'problem.not_referenced': 'Die Finger sind nicht referenziert: erst Referenzfahrt.', 'problem.already_running': 'Es läuft schon ein Befehl.', 'problem.lease_held': '{holder} steuert.', 'problem.stale_lease': 'Inzwischen steuert jemand anderes.', 'problem.stale_fast_stop': 'Es gibt einen neueren FAST STOP: erst ansehen.', 'problem.fast_stop_unconfirmed': 'Der Greifer hat den FAST STOP noch nicht bestätigt.',
  'problem.out_of_range': '{field} ist {value}, erlaubt ist {min} bis {max}.', 'problem.device_refused': 'Der Greifer lehnt ab.', 'problem.overloaded': 'Zu viel auf einmal: noch einmal versuchen.', 'problem.internal': 'Das Gateway hat einen Fehler gemacht.', 'problem.device_protocol': 'Die Antwort des Greifers ergibt keinen Sinn.', 'problem.link_down': 'Es gibt keine Verbindung zum Greifer.', 'problem.journal_down': 'Das Journal nimmt nichts an.', 'problem.device_timeout': 'Der Greifer hat nicht rechtzeitig geantwortet.', 'problem.not_found': 'Das gibt es nicht.',
};
