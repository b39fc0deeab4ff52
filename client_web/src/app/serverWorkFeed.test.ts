import { describe, expect, it } from 'vitest'
import { ServerWorkFeed } from './serverWorkFeed'

const skipping = { age_s: null, saved_ms: 1, saved_total_ms: 2, spent_total_ms: 3, error_bound: 0 }
const answer = { processes: { illumination: { stages: [], skipping } } }

function settled(): Promise<void> {
  return new Promise((resolve) => setTimeout(resolve, 0))
}

describe('ServerWorkFeed', () => {
  it('asks once a second while somebody looks, and not while a question is open', async () => {
    const open: ((json: unknown) => void)[] = []
    const feed = new ServerWorkFeed(() => new Promise((resolve) => open.push(resolve)))
    expect(feed.work).toBeNull()
    feed.look(0)
    feed.look(5000)
    expect(open.length).toBe(1)
    open[0]?.(answer)
    await settled()
    expect(feed.work?.savedTotalMs).toBe(2)
    feed.look(900)
    expect(open.length).toBe(1)
    feed.look(1000)
    expect(open.length).toBe(2)
  })

  it('forgets an old answer when the server does not answer any more', async () => {
    let asked = 0
    const feed = new ServerWorkFeed(async () => {
      asked += 1
      if (asked === 2) {
        throw new Error('gone')
      }
      return asked === 1 ? answer : null
    })
    feed.look(0)
    await settled()
    expect(feed.work).not.toBeNull()
    feed.look(2000)
    await settled()
    expect(feed.work).toBeNull()
    feed.look(4000)
    await settled()
    expect(feed.work).toBeNull()
  })
})
