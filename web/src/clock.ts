// The laptop's clock and the station's differ. The smallest difference seen between arrival
// and the time inside a message is the offset plus the quickest way here; ages count by it.

export class StationClock {
  private readonly differences_ms: number[] = [];

  /** Station time of the newest message, ms: what a replay, whose time may run or stand as it likes, counts by. */
  newest_ms = 0;

  constructor(
    private readonly now_ms: () => number = Date.now,
    private readonly window = 60,
  ) {}

  observe(server_ms: number): void {
    this.newest_ms = server_ms;
    this.differences_ms.push(this.now_ms() - server_ms);
    if (this.differences_ms.length > this.window) this.differences_ms.shift();
  }

  get known(): boolean {
    return this.differences_ms.length > 0;
  }

  /** How far this browser's clock is ahead of the station's, ms. */
  get offset_ms(): number {
    return this.known ? Math.min(...this.differences_ms) : 0;
  }

  /** Station time now, ms. */
  station_ms(): number {
    return this.now_ms() - this.offset_ms;
  }

  reset(): void {
    this.differences_ms.length = 0;
  }
}
