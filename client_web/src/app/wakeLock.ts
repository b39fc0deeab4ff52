/** Keeps the screen on from the first touch: a tablet that sleeps loses its connection. */
export function keepScreenOn(element: HTMLElement): void {
  let wanted = false
  const request = (): void => {
    if (wanted && document.visibilityState === 'visible' && 'wakeLock' in navigator) {
      // Refused on low battery and in insecure contexts; the picture works all the same.
      navigator.wakeLock.request('screen').catch(() => undefined)
    }
  }
  element.addEventListener('pointerdown', () => {
    if (!wanted) {
      wanted = true
      request()
    }
  })
  document.addEventListener('visibilitychange', request)
}
