"""The words of the report, English and Italian, in one place; each written, not translated word by word."""

from __future__ import annotations

import re
from typing import Literal

Language = Literal["en", "it"]

# One line a sentence: a catalogue is read as a table.
# fmt: off
ENGLISH = {
    "title": "Event report",
    "crash": "Crash", "rollover": "Rollover", "parked_impact": "Impact while parked", "harsh_braking": "Harsh braking",
    "harsh_acceleration": "Harsh acceleration", "harsh_cornering": "Harsh cornering", "road_shock": "Road shock",
    "handling": "Handling of the box",
    "vehicle": "Vehicle", "plate": "Plate", "box": "Box", "time": "Time zero (UTC)", "boot": "Run of the box's clock",
    "place": "Place at time zero", "event": "Event", "revision": "Revision", "class": "Class",
    "car": "car", "van": "van", "truck": "truck", "bus": "bus", "motorcycle": "motorcycle",
    "no_vehicle": "not assigned to a vehicle", "not_recorded": "not recorded",
    "page": "Page {page} of {pages}", "foot": "Canonical event JSON, SHA-256 {hash}",
    "summary": "What the box recorded",
    "s_what": "{kind} on {date} at {time} UTC ({sigma}).",
    "s_force": "The force came from {where} ({clock} o'clock), at {pdof}° from straight ahead, clockwise; with 95 % probability between {low}° and {high}°.",
    "s_dv": "The velocity of the vehicle changed by {dv} km/h; with 95 % probability by {low} to {high} km/h.",
    "s_speed": "Just before the impact it moved at {v} km/h ({low} to {high} km/h).",
    "s_braked": "It was being braked from {t} s before the impact on, at most with {a} m/s².",
    "s_not_braked": "No braking that lasted until the impact was recorded.",
    "s_rest": "It came to rest {t} s after the impact, {d} m from the place of impact (95 % within {r} m).",
    "s_earlier": "An impact came before it, {t} s earlier, with a change of velocity of {dv} km/h ({low} to {high} km/h).",
    "s_second": "A further impact followed {t} s later, with a change of velocity of {dv} km/h ({low} to {high} km/h).",
    "s_roll": "It rolled by as much as {angle}° ({low}° to {high}°; positive: right side down).",
    "s_clipped": "The impact was harder than the sensor measures: {n} samples reached full scale. What is missing was estimated, and the intervals carry it.",
    "where1": "ahead on the right", "where2": "the right, ahead", "where3": "the right", "where4": "the right, behind",
    "where5": "behind on the right", "where6": "behind", "where7": "behind on the left", "where8": "the left, behind",
    "where9": "the left", "where10": "the left, ahead", "where11": "ahead on the left", "where12": "straight ahead",
    "sketch": "Direction of the force (PDOF)", "sketch_note": "Seen from above; arrow: best estimate; sector: 95 % interval.",
    "sketch_unknown": "Direction not known: the mounting of the box was not known.",
    "front": "front",
    "key_dv": "Change of velocity", "key_pdof": "Direction of force", "key_speed": "Speed before impact", "key_peak": "Peak",
    "at_least": "at least", "oclock": "o'clock",
    "curves": "The course of the impact", "plot_dv": "Change of velocity since time zero [km/h]", "plot_pulse": "Acceleration of the box, gravity removed [g]",
    "plot_speed": "Speed over ground [km/h]", "ms": "ms after time zero", "s": "s after time zero",
    "along": "longitudinal", "across": "lateral", "resultant": "resultant", "band": "95 % band", "recorded": "as recorded",
    "estimated": "with the estimate of what is missing", "full_scale": "sample at full scale",
    "no_pulse": "No pulse was recorded.", "no_way": "No path: the box had no usable fixes around the event.",
    "way": "The way of the vehicle", "map_all": "From 30 s before to 30 s after", "map_near": "Around the impact",
    "map_note": "North is up. Grid: {grid} m. Ellipses: 95 % of the position, every 5 s. Drawn in local metres around time zero; no map underneath is part of the evidence.",
    "impact": "impact", "start": "start", "rest": "rest", "before": "before", "after": "after", "last5": "last 5 s",
    "driver": "The last five seconds", "d_t": "Time [s]", "d_v": "Speed [km/h]", "d_a": "Along [m/s²]", "d_y": "Across [m/s²]", "d_r": "Yaw rate [°/s]",
    "d_brake": "Braking until the impact", "d_from": "from {t} s on, at most {a} m/s²", "d_none": "none", "d_steer": "Steering",
    "left": "to the left", "right": "to the right", "none": "none", "d_stop": "Distance to rest",
    "numbers": "All numbers", "n_name": "Quantity", "n_value": "Value", "n_interval": "95 % interval", "n_unit": "Unit",
    "n_dvx": "Delta-V, longitudinal", "n_dvy": "Delta-V, lateral", "n_dvr": "Delta-V, resultant", "n_tmax": "Time of the maximum",
    "n_pdof": "Principal direction of force", "n_clock": "the same, clock direction", "n_speed": "Impact speed", "n_rebound": "Rebound speed",
    "n_peak": "Peak acceleration", "n_mean": "Mean acceleration", "n_duration": "Duration (49 CFR 563)", "n_measured": "Delta-V of the samples as recorded",
    "n_gps": "Delta-V by GPS alone", "n_roll": "Largest roll angle", "n_asi": "ASI (EN 1317-1:2010)", "n_asi98": "ASI (EN 1317-1:1998)",
    "n_olc": "OLC (Euro NCAP TB 027)", "n_thiv": "THIV (EN 1317-1)", "n_phd": "PHD (EN 1317-1)", "n_second": "Impact {k}, delta-V", "n_second_pdof": "Impact {k}, direction",
    "n_filter": "Filter of the peak", "n_peak_event": "Largest acceleration", "n_length": "Duration",
    "risk": "Risk of injury by published curves", "r_curve": "Curve", "r_people": "Population", "r_level": "Level", "r_p": "Probability",
    "risk_note": "The interval is that of the change of velocity alone. Curves disagree with each other; none of them tells what happened to a person.",
    "contradictions": "Contradictions around the event", "contradictions_none": "None found in the data around the event.",
    "quality": "How good the data are", "q_good": "No remark.", "q_basis": "What the numbers rest on",
    "q_rate": "Sample rate", "q_scale": "Full scale of the accelerometer", "q_clip": "Samples at full scale", "q_gyro": "Gyro", "q_fixes": "Fixes used before and after",
    "q_lag": "Lag of the receiver, speed and course", "q_mount": "Mounting of the box", "q_sigma": "its 1 sigma about x, y, z", "q_window": "Samples used, box clock", "q_conf": "Confidence that it is of this kind",
    "yes": "yes", "no": "no", "ready": "known", "settling": "known, not yet sure", "insufficient": "not known", "not_fixed": "the box was not fixed",
    "provenance": "Where this comes from", "p_text": "This report was made from the canonical event JSON whose hash stands at the foot of every page. That JSON is computed from the uploads below, whose hashes are links of the box's chain. The same inputs and the same version give the same bytes.",
    "p_software": "Software", "p_algorithm": "Algorithm", "p_inputs": "SHA-256 of the inputs", "p_event": "SHA-256 of the event JSON", "p_mounting": "Mounting estimate", "p_clock": "Clock of the box",
    "p_clock_gnss": "by GPS, {s}", "p_clock_arrival": "by the time of arrival, {s}", "p_link": "Link", "p_stream": "Stream", "p_span": "Box clock [s]", "p_rows": "Rows", "p_body": "SHA-256 of the body as it came", "p_columns": "SHA-256 of its columns",
    "p_verify": 'To check: download the evidence archive of this event and run <font name="Scatola-Mono">python3 verify.py</font> in it; it needs nothing but Python. <font name="Scatola-Mono">scatola verify</font> checks a whole box.',
    "conventions": "Conventions", "c_text": "Axes by SAE J211: x forward, y right, z down. Delta-V is the change of velocity of the box in the vehicle's axes at time zero. Time zero, end of event and element names follow 49 CFR 563; this is not the output of the vehicle's own event data recorder. ISO/TR 12353-3 guides the use of recorded pulses. An interval holds the truth with 95 % probability. What the box cannot know is \"not recorded\".",
    "burst": "burst", "continuous": "continuous",
    "link_more": "and {n} more in the evidence archive",
    "spread": "± {s} s", "spread_small": "within {s} s", "unfiltered": "none, sampled at {rate} Hz",
    "certificate": "Certificate of installation", "cert_foot": "Certificate, SHA-256 {hash}",
    "cert_summary": "The mounting of this box in this vehicle is known.",
    "cert_summary_sigma": "The mounting of this box in this vehicle is known to ± {sigma}° (1 sigma, about the axis that is known worst).",
    "cert_installed": "Installed", "cert_installer": "Installer", "cert_how": "How", "cert_mounting": "How the box sits",
    "cert_first": "by driving", "cert_moved": "by driving, after the box was moved", "cert_swapped": "by driving, in its new vehicle", "cert_manual": "by hand",
    "cert_axis": "Axis", "cert_angle": "Turn of the box", "cert_sigma": "1 sigma about V", "cert_cone": "95 % cone of A", "cert_matrix": "R_va, row of V",
    "cert_note": "V: the vehicle's axes, x forward, y right, z down. A: the box's axes. R_va turns what the box measures into the vehicle's axes: Ry(θ) Rz(φ) Rx(ψ). With 95 % probability each axis of the box points into its cone, given here where it is widest.",
    "cert_data_at": "Data until", "cert_hash": "SHA-256 of the certificate", "cert_verify": "To check: open the address, signed in. The service makes the certificate again from what it stores and compares the hash.",
}

ITALIAN = {
    "title": "Rapporto d'evento",
    "crash": "Urto", "rollover": "Ribaltamento", "parked_impact": "Urto a veicolo in sosta", "harsh_braking": "Frenata brusca",
    "harsh_acceleration": "Accelerazione brusca", "harsh_cornering": "Curva brusca", "road_shock": "Colpo dalla strada",
    "handling": "Manipolazione della scatola",
    "vehicle": "Veicolo", "plate": "Targa", "box": "Scatola", "time": "Istante zero (UTC)", "boot": "Accensione della scatola",
    "place": "Luogo all'istante zero", "event": "Evento", "revision": "Revisione", "class": "Classe",
    "car": "autovettura", "van": "furgone", "truck": "autocarro", "bus": "autobus", "motorcycle": "motociclo",
    "no_vehicle": "non assegnata a un veicolo", "not_recorded": "non registrato",
    "page": "Pagina {page} di {pages}", "foot": "JSON canonico dell'evento, SHA-256 {hash}",
    "summary": "Che cosa ha registrato la scatola",
    "s_what": "{kind} il {date} alle {time} UTC ({sigma}).",
    "s_force": "La forza è venuta da {where} (ore {clock}), a {pdof}° dalla direzione di marcia in senso orario; con probabilità del 95 % fra {low}° e {high}°.",
    "s_dv": "La velocità del veicolo è cambiata di {dv} km/h; con probabilità del 95 % da {low} a {high} km/h.",
    "s_speed": "Subito prima dell'urto procedeva a {v} km/h (da {low} a {high} km/h).",
    "s_braked": "Frenava da {t} s prima dell'urto, al massimo con {a} m/s².",
    "s_not_braked": "Non è registrata alcuna frenata durata fino all'urto.",
    "s_rest": "Si è fermato {t} s dopo l'urto, a {d} m dal punto d'urto (entro {r} m al 95 %).",
    "s_earlier": "Un urto l'ha preceduto, {t} s prima, con una variazione di velocità di {dv} km/h (da {low} a {high} km/h).",
    "s_second": "Un altro urto è seguito dopo {t} s, con una variazione di velocità di {dv} km/h (da {low} a {high} km/h).",
    "s_roll": "Ha rollato fino a {angle}° (da {low}° a {high}°; positivo: lato destro in basso).",
    "s_clipped": "L'urto ha superato quanto il sensore misura: {n} campioni sono a fondo scala. Ciò che manca è stato stimato e gli intervalli ne tengono conto.",
    "where1": "davanti a destra", "where2": "destra, in avanti", "where3": "destra", "where4": "destra, all'indietro",
    "where5": "dietro a destra", "where6": "dietro", "where7": "dietro a sinistra", "where8": "sinistra, all'indietro",
    "where9": "sinistra", "where10": "sinistra, in avanti", "where11": "davanti a sinistra", "where12": "davanti",
    "sketch": "Direzione della forza (PDOF)", "sketch_note": "Vista dall'alto; freccia: migliore stima; settore: intervallo al 95 %.",
    "sketch_unknown": "Direzione non nota: il montaggio della scatola non era noto.",
    "front": "fronte",
    "key_dv": "Variazione di velocità", "key_pdof": "Direzione della forza", "key_speed": "Velocità prima dell'urto", "key_peak": "Picco",
    "at_least": "almeno", "oclock": "ore",
    "curves": "Andamento dell'urto", "plot_dv": "Variazione di velocità dall'istante zero [km/h]", "plot_pulse": "Accelerazione della scatola, tolta la gravità [g]",
    "plot_speed": "Velocità al suolo [km/h]", "ms": "ms dall'istante zero", "s": "s dall'istante zero",
    "along": "longitudinale", "across": "laterale", "resultant": "risultante", "band": "banda al 95 %", "recorded": "come registrata",
    "estimated": "con la stima di ciò che manca", "full_scale": "campione a fondo scala",
    "no_pulse": "Nessun impulso registrato.", "no_way": "Nessun percorso: la scatola non aveva posizioni utili intorno all'evento.",
    "way": "Il percorso del veicolo", "map_all": "Da 30 s prima a 30 s dopo", "map_near": "Intorno all'urto",
    "map_note": "Il nord è in alto. Reticolo: {grid} m. Ellissi: 95 % della posizione, ogni 5 s. Disegno in metri locali intorno all'istante zero; nessuna carta di sfondo fa parte della prova.",
    "impact": "urto", "start": "inizio", "rest": "quiete", "before": "prima", "after": "dopo", "last5": "ultimi 5 s",
    "driver": "Gli ultimi cinque secondi", "d_t": "Tempo [s]", "d_v": "Velocità [km/h]", "d_a": "Longitudinale [m/s²]", "d_y": "Laterale [m/s²]", "d_r": "Imbardata [°/s]",
    "d_brake": "Frenata fino all'urto", "d_from": "da {t} s, al massimo {a} m/s²", "d_none": "nessuna", "d_steer": "Sterzata",
    "left": "a sinistra", "right": "a destra", "none": "nessuna", "d_stop": "Spazio d'arresto",
    "numbers": "Tutti i valori", "n_name": "Grandezza", "n_value": "Valore", "n_interval": "Intervallo al 95 %", "n_unit": "Unità",
    "n_dvx": "Delta-V longitudinale", "n_dvy": "Delta-V laterale", "n_dvr": "Delta-V risultante", "n_tmax": "Istante del massimo",
    "n_pdof": "Direzione principale della forza", "n_clock": "la stessa, in ore", "n_speed": "Velocità d'urto", "n_rebound": "Velocità di rimbalzo",
    "n_peak": "Accelerazione di picco", "n_mean": "Accelerazione media", "n_duration": "Durata (49 CFR 563)", "n_measured": "Delta-V dei campioni come registrati",
    "n_gps": "Delta-V dal solo GPS", "n_roll": "Massimo angolo di rollio", "n_asi": "ASI (EN 1317-1:2010)", "n_asi98": "ASI (EN 1317-1:1998)",
    "n_olc": "OLC (Euro NCAP TB 027)", "n_thiv": "THIV (EN 1317-1)", "n_phd": "PHD (EN 1317-1)", "n_second": "Urto {k}, delta-V", "n_second_pdof": "Urto {k}, direzione",
    "n_filter": "Filtro del picco", "n_peak_event": "Massima accelerazione", "n_length": "Durata",
    "risk": "Rischio di lesioni secondo curve pubblicate", "r_curve": "Curva", "r_people": "Popolazione", "r_level": "Livello", "r_p": "Probabilità",
    "risk_note": "L'intervallo è quello della sola variazione di velocità. Le curve sono in disaccordo fra loro; nessuna dice che cosa è accaduto a una persona.",
    "contradictions": "Contraddizioni intorno all'evento", "contradictions_none": "Nessuna nei dati intorno all'evento.",
    "quality": "Qualità dei dati", "q_good": "Nessuna osservazione.", "q_basis": "Su che cosa poggiano i valori",
    "q_rate": "Frequenza di campionamento", "q_scale": "Fondo scala dell'accelerometro", "q_clip": "Campioni a fondo scala", "q_gyro": "Giroscopio", "q_fixes": "Posizioni usate prima e dopo",
    "q_lag": "Ritardo del ricevitore, velocità e rotta", "q_mount": "Montaggio della scatola", "q_sigma": "suo 1 sigma attorno a x, y, z", "q_window": "Campioni usati, orologio della scatola", "q_conf": "Confidenza sul tipo d'evento",
    "yes": "sì", "no": "no", "ready": "noto", "settling": "noto, non ancora certo", "insufficient": "non noto", "not_fixed": "la scatola non era fissata",
    "provenance": "Da dove viene", "p_text": "Questo rapporto è tratto dal JSON canonico dell'evento, la cui impronta sta in calce a ogni pagina. Il JSON è calcolato dagli invii elencati qui sotto, le cui impronte sono anelli della catena della scatola. Gli stessi dati e la stessa versione danno gli stessi byte.",
    "p_software": "Programma", "p_algorithm": "Algoritmo", "p_inputs": "SHA-256 dei dati d'ingresso", "p_event": "SHA-256 del JSON dell'evento", "p_mounting": "Stima del montaggio", "p_clock": "Orologio della scatola",
    "p_clock_gnss": "dal GPS, {s}", "p_clock_arrival": "dall'ora d'arrivo, {s}", "p_link": "Anello", "p_stream": "Flusso", "p_span": "Orologio [s]", "p_rows": "Righe", "p_body": "SHA-256 dell'invio come arrivato", "p_columns": "SHA-256 delle sue colonne",
    "p_verify": "Per controllare: si scarica l'archivio delle prove di questo evento e vi si esegue <font name=\"Scatola-Mono\">python3 verify.py</font>; basta Python. <font name=\"Scatola-Mono\">scatola verify</font> controlla un'intera scatola.",
    "conventions": "Convenzioni", "c_text": "Assi secondo SAE J211: x avanti, y a destra, z in basso. Delta-V è la variazione di velocità della scatola negli assi del veicolo all'istante zero. Istante zero, fine dell'evento e nomi degli elementi seguono 49 CFR 563; questo non è l'uscita del registratore d'eventi del veicolo. ISO/TR 12353-3 guida l'uso degli impulsi registrati. Un intervallo contiene il valore vero con probabilità del 95 %. Ciò che la scatola non può sapere è «non registrato».",
    "burst": "raffica", "continuous": "continuo",
    "link_more": "e altri {n} nell'archivio delle prove",
    "spread": "± {s} s", "spread_small": "a meno di {s} s", "unfiltered": "nessuno, campionato a {rate} Hz",
    "certificate": "Certificato d'installazione", "cert_foot": "Certificato, SHA-256 {hash}",
    "cert_summary": "Il montaggio di questa scatola in questo veicolo è noto.",
    "cert_summary_sigma": "Il montaggio di questa scatola in questo veicolo è noto entro ± {sigma}° (1 sigma, attorno all'asse meno noto).",
    "cert_installed": "Installata", "cert_installer": "Installatore", "cert_how": "Modo", "cert_mounting": "Come sta la scatola",
    "cert_first": "guidando", "cert_moved": "guidando, dopo uno spostamento", "cert_swapped": "guidando, nel nuovo veicolo", "cert_manual": "a mano",
    "cert_axis": "Asse", "cert_angle": "Rotazione della scatola", "cert_sigma": "1 sigma attorno a V", "cert_cone": "Cono 95 % di A", "cert_matrix": "R_va, riga di V",
    "cert_note": "V: assi del veicolo, x avanti, y a destra, z in basso. A: assi della scatola. R_va porta negli assi del veicolo ciò che la scatola misura: Ry(θ) Rz(φ) Rx(ψ). Con probabilità del 95 % ogni asse della scatola punta dentro il proprio cono, qui dato dov'è più largo.",
    "cert_data_at": "Dati fino a", "cert_hash": "SHA-256 del certificato", "cert_verify": "Per verificare: aprire l'indirizzo dopo l'accesso. Il servizio rifà il certificato da ciò che conserva e confronta l'hash.",
}

# What a remark means; the numbers of its English sentence stand in the table of what the numbers rest on.
ITALIAN_REMARKS = {
    "clipped": "Alcuni campioni sono a fondo scala; l'impulso mancante è stato stimato.",
    "axes_rotating": "Senza giroscopio: delta-V negli assi della scatola, che ruotano con il veicolo.",
    "gyro_gap": "Il giroscopio tace per parte dell'evento.",
    "indices_clipped": "ASI, OLC, THIV e PHD non sono dati per un impulso a fondo scala.",
    "indices_incomplete": "Gli indici di severità non sono dati per un impulso incompleto.",
    "indices_not_given": "Gli indici di severità richiedono il montaggio e almeno 78 Hz.",
    "asi_without_cfc180": "ASI calcolato senza il filtro CFC180, che la frequenza di campionamento non consente.",
    "thiv_needs_gyro": "THIV e PHD richiedono la velocità d'imbardata.",
    "phd_needs_rate": "PHD richiede quattro campioni in 10 ms.",
    "olc_not_given": "OLC non è dato per questo impulso.",
    "mounting_settling": "Il montaggio non era ancora certo; il suo sigma è propagato nei valori.",
    "mounting_unknown": "Il montaggio non era noto: sono date soltanto le risultanti.",
    "mounting_disagrees": "Prima dell'urto la gravità non era dove la vuole il montaggio: la scatola è stata girata, o misura con altro segno. Le direzioni non sono date.",
    "mounting_before_change": "È usato il montaggio valido prima che la scatola fosse mossa.",
    "no_gps": "Nessuna posizione utile: né velocità d'urto, né percorso, né controllo di delta-V.",
    "gps_lag_unknown": "Il ritardo del ricevitore non è noto; le posizioni vicine all'urto non sono usate.",
    "gps_disagrees": "GPS e accelerometro non concordano; il GPS non è usato per delta-V.",
    "aliasing_possible": "La frequenza di campionamento può nascondere vibrazioni (aliasing).",
    "short_context": "C'è poco contesto prima o dopo l'evento.",
    "starts_in_event": "La registrazione comincia a evento iniziato: a delta-V manca l'inizio.",
    "ends_in_event": "La registrazione finisce prima del termine dell'integrazione.",
    "gap_in_event": "Mancano campioni entro l'evento; l'intervallo è più largo per questo.",
    "off_centre": "Il veicolo ha ruotato: delta-V è quello della scatola, non del baricentro.",
    "box_turned": "Dopo l'evento la scatola giace diversamente.",
    "free_fall": "La scatola è caduta liberamente prima del colpo.",
    "speed_unchanged": "La velocità GPS non mostra un cambiamento durevole.",
    "multi_event": "Più urti entro 5 s: i numeri sono quelli del più forte.",
    "not_lasting": "La variazione di velocità è stata restituita entro un quarto di secondo.",
    "below_trigger": "Colpo laterale sotto la soglia di 49 CFR 563.",
    "lies_differently": "La scatola è inclinata.",
    "turned_over": "Secondo il giroscopio il veicolo si è rovesciato.",
    "drove_on": "Dopo il colpo la scatola giace diversamente, e il veicolo ha proseguito la marcia.",
    "shaken_before": "La scatola era maneggiata prima del colpo, a veicolo fermo.",
    "no_gravity": "La registrazione non mostra la gravità; non è detto come stava il veicolo.",
    "aliasing_likely": "È probabile che vibrazioni più rapide del campionamento falsino i valori (aliasing).",
    "utc_from_arrival": "Nessuna posizione ha dato l'UTC: è l'ora d'arrivo, entro mezzo minuto.",
    "box_moved_before": "La scatola è stata mossa, scambiata o impostata a mano nei sette giorni prima dell'evento.",
    "box_not_fixed": "La scatola non era fissata nel veicolo.",
    "silent_before": "I dati della scatola cominciano meno di un minuto prima dell'evento.",
    "silent_after": "La scatola si è spenta entro un minuto dall'evento.",
    "gap_around": "Mancano dati nei dieci minuti intorno all'evento.",
    "batches_missing": "Alcuni invii intorno all'evento non sono mai arrivati.",
    "unreadable_data": "Alcuni invii intorno all'evento non sono leggibili.",
    "chain_broken": "La catena delle prove non regge intorno all'evento.",
    "clock_jump": "L'orologio della scatola è saltato, o due orologi segnano lo stesso momento.",
    "clock_unsure": "Nessuna posizione ha dato l'UTC: l'ora dell'evento è incerta.",
    "distance_disagrees": "Velocità e posizioni del ricevitore danno distanze diverse per il viaggio dell'evento.",
    "claim_disagrees": "La direzione denunciata non è quella registrata dalla scatola.",
    "rows_out_of_order": "Alcune righe sono arrivate fuori ordine e sono state ordinate.",
    "rows_repeated": "Alcune righe ripetevano un istante e sono state tolte.",
    "inertial_rows_repeated": "Alcune righe inerziali ripetevano un istante e sono state tolte.",
    "gnss_rows_repeated": "Alcune righe GNSS ripetevano un istante e sono state tolte.",
}

# Levels and populations of the curves of injury; the names of scales stay.
ITALIAN_RISKS = {
    "fatal": "mortale",
    "front-seat occupants of cars in US tow-away crashes (Wang 2022, DOT HS 813 219)":
        "occupanti dei sedili anteriori di autovetture, urti negli USA con rimozione del veicolo (Wang 2022, DOT HS 813 219)",
    "as shipped with TUM's ethical trajectory planning, population not stated":
        "come fornita con la pianificazione etica di traiettorie della TUM, popolazione non dichiarata",
    "German in-depth accident study, as shipped with TUM's ethical trajectory planning":
        "studio tedesco approfondito degli incidenti, come fornita con la pianificazione etica di traiettorie della TUM",
}
# fmt: on

_MONTHS = {
    "en": [
        "January",
        "February",
        "March",
        "April",
        "May",
        "June",
        "July",
        "August",
        "September",
        "October",
        "November",
        "December",
    ],
    "it": [
        "gennaio",
        "febbraio",
        "marzo",
        "aprile",
        "maggio",
        "giugno",
        "luglio",
        "agosto",
        "settembre",
        "ottobre",
        "novembre",
        "dicembre",
    ],
}


class Words:
    """One language: sentences, numbers, dates; `speed` is the unit in which speeds are said."""

    def __init__(self, language: Language, speed: str = "km/h") -> None:
        self.language: Language = language
        self.speed = speed
        self._catalogue = ENGLISH if language == "en" else ITALIAN

    def __call__(self, key: str, **values: object) -> str:
        """A sentence with its values put in."""
        return self._catalogue[key].replace("km/h", self.speed).format(**values)

    def number(self, value: float | None, digits: int = 1, *, sign: bool = False) -> str:
        """Fixed decimals in the language's way, a real minus sign, never "-0"."""
        if value is None:
            return self("not_recorded")
        text = f"{value:{'+' if sign else ''}.{digits}f}"
        if not any(c in "123456789" for c in text):
            text = text.lstrip("+-")
        text = text.replace("-", "\N{MINUS SIGN}")
        return text if self.language == "en" else text.replace(".", ",")

    def short(self, value: float) -> str:
        """As many decimals as it has, in the language's way."""
        text = f"{value:g}"
        return text if self.language == "en" else text.replace(".", ",")

    def spread(self, sigma_s: float) -> str:
        """How well a time is known, never as "± 0.00 s"."""
        if sigma_s < 0.005:
            return self("spread_small", s=self.number(0.01, 2))
        return self("spread", s=self.number(sigma_s, 2))

    def peak_filter(self, name: str) -> str:
        """What a peak was read after; the names of filters are the same in every language."""
        found = re.fullmatch(r"none, sampled at (\d+) Hz", name)
        return name if found is None else self("unfiltered", rate=found[1])

    def risk(self, text: str) -> str:
        """A level of injury, or whom a curve is of; as it stands where the language has nothing."""
        return text if self.language == "en" else ITALIAN_RISKS.get(text, text)

    def interval(self, bounds: list[float] | None, digits: int = 1) -> str:
        """Both ends, or nothing."""
        if bounds is None:
            return "\N{EN DASH}"
        separator = ", " if self.language == "en" else "; "
        return f"[{separator.join(self.number(end, digits) for end in bounds)}]"

    def date(self, year: int, month: int, day: int) -> str:
        """A day in words."""
        return f"{day} {_MONTHS[self.language][month - 1]} {year}"

    def remark(self, code: str, detail: str) -> str:
        """What a remark means; its own English sentence where the language has none."""
        return detail if self.language == "en" else ITALIAN_REMARKS.get(code, detail)
