// The rows of the steps so far, for trails and plot. Missing rows, old or skipped by a slow page, are
// requested in pieces, those around the shown step first.
const USUAL_ROWS = 10000, PIECE_ROWS = 1000, ASKED_AFTER_MS = 500;
const ROW_PLACES = 16;

/** The row of a step's frame, as the server makes it. */
export const rowOf = ({ step, places, truth }) =>
  [step, places.slice(0, ROW_PLACES).map((p) => [p.cluster, p.slot, p.p, ...p.pose]), truth];

export class StepRows {
  /** @param ask requests the rows before a step; onEarlier takes them */
  constructor(ask) {
    Object.assign(this, { ask, rows: [], oldest: 0, gaps: [], most: USUAL_ROWS, asked: null, until: null, timer: 0 });
  }

  /** The oldest and the newest archived step; null: there is none. */
  get range() {
    return this.rows.length ? [this.oldest, this.rows[this.rows.length - 1][0]] : null;
  }

  begin({ oldest, rows }) {
    Object.assign(this, { oldest, rows, gaps: [], asked: null });
    if (rows.length && rows[0][0] > oldest) this.gaps.push(rows[0][0]);
  }

  add(row) {
    const { rows } = this;
    while (rows.length && rows[rows.length - 1][0] >= row[0]) rows.pop();
    if (row[0] > (rows[rows.length - 1]?.[0] ?? this.oldest - 1) + 1) this.gaps.push(row[0]); // some were skipped
    rows.push(row);
    this.forgetOld();
  }

  /** Add the rows before the requested step, as many as one piece holds. */
  onEarlier(piece) {
    const before = this.asked, first = piece[0]?.[0] ?? before;
    this.asked = null;
    if (before === null) return;
    const isJoined = piece.length < PIECE_ROWS || this.rows.some(([step]) => step === first);
    this.gaps = this.gaps.filter((gap) => gap > before || (gap <= first && piece.length === PIECE_ROWS));
    if (!isJoined) this.gaps = [...this.gaps, first].sort((a, b) => a - b);
    this.rows = [...this.rows.filter(([step]) => step < first), ...piece, ...this.rows.filter(([step]) => step >= before)];
    if (piece.length < PIECE_ROWS) this.oldest = this.rows[0]?.[0] ?? 0;
    this.forgetOld();
  }

  forgetOld() {
    if (this.rows.length > this.most) {
      this.rows = this.rows.slice(-this.most);
      this.oldest = this.rows[0][0];
    }
    this.gaps = this.gaps.filter((gap) => gap > this.oldest);
  }

  /** @param until the last step that is drawn now */
  askForGaps(until) {
    if (this.asked !== null || this.timer || !this.gaps.length) return;
    const gap = this.gaps.find((one) => one > until) ?? this.gaps[this.gaps.length - 1];
    const known = this.rows.findLast(([step]) => step < gap)?.[0] ?? -1;
    const isAround = gap > until && known < until && until !== this.until; // once: its last step may be lost
    this.asked = isAround ? until + 1 : gap;
    if (isAround) this.until = until;
    this.timer = setTimeout(() => {
      this.timer = 0;
      if (this.asked !== null) this.ask(this.asked);
    }, ASKED_AFTER_MS);
  }
}
